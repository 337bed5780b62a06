"""An exported policy is a small checkpoint with a model card."""

from pathlib import Path
from shutil import copytree

import pytest
import torch

from fishrl.training import load_plan, load_policy
from fishrl.training.export import export_policy
from fishrl.training.logger import read_rows
from fishrl.training.loop import Training


def test_export_writes_best_policy_and_model_card(whole: Training, tmp_path: Path) -> None:
    run = whole.folder.path
    folder = export_policy(run, tmp_path / "policies" / "toy", revision="abc")
    exported, best = load_policy(folder), load_policy(run)
    for one, other in zip(exported.parameters(), best.parameters(), strict=True):
        assert torch.equal(one, other)
    assert load_plan(folder).task == whole.task
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    assert size < 0.2 * sum(f.stat().st_size for f in run.rglob("*") if f.is_file())
    private = str(whole.folder.path.parent)  # where the run was
    assert not any(private.encode() in file.read_bytes() for file in folder.rglob("*.*"))
    card = (folder / "README.md").read_text()
    for words in ("task: ToyPredation", "DiscreteSAC", "abc", "| success rate |", "240 of 240"):
        assert words in card
    for row, full in zip(*(read_rows(each / "metrics.csv") for each in (folder, run)), strict=True):
        assert list(row) == list(full)
        for short, cell in zip(row.values(), full.values(), strict=True):
            assert len(short) <= len(cell) and (not cell) == (not short)
            assert float(short or 0) == pytest.approx(float(cell or 0), rel=1e-6)


def test_failed_export_leaves_nothing_and_an_empty_folder_is_taken_alone(
    whole: Training, tmp_path: Path
) -> None:
    run, folder, other = (tmp_path / name for name in ("run", "out", "out-000000240"))
    copytree(whole.folder.path, run)
    (run / "metrics.csv").write_text("")
    with pytest.raises(ValueError, match="it lacks frames"):
        export_policy(run, folder)
    (run / "metrics.csv").unlink()
    folder.mkdir()
    other.mkdir()
    export_policy(run, folder)
    assert other.is_dir()
