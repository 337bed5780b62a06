"""A run made before the training loop moved into the library loads, is evaluated and goes on.

``tests/goldens/drqn_run.tar.xz`` is a run of 16 frames by that version, and the table beside it
holds the metrics of the same run made 24 frames long. To make them anew: ``fishrl train
algorithm=drqn`` with the settings in ``config.yaml`` of the archive.
"""

from __future__ import annotations

import csv
import json
import tarfile
from pathlib import Path

import pytest
import torch

from fishrl.training import evaluate, load_plan, load_policy, resume
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.export import export_policy
from tests.training.test_goldens import GOLDENS, read


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    with tarfile.open(GOLDENS / "drqn_run.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path / "run"


def test_a_stored_run_is_evaluated_and_goes_on_exactly(stored: Path) -> None:
    assert load_plan(stored)[1].algorithm == DRQN()
    summary = json.loads((stored / "summary.json").read_text())
    result = evaluate(stored, episodes=1, num_envs=1, compile=False)
    # 1e-5: float32 sums may be ordered differently on another processor
    assert result["mean_return"] == pytest.approx(summary["mean_return"], rel=1e-5)
    assert resume(stored)["frames"] == 16  # it is finished
    resume(stored, total_frames=20, baselines=())
    with (stored / "metrics.csv").open(newline="") as file:
        assert [row["frames"] for row in csv.DictReader(file)][-1] == "20"
    row = read(stored / "metrics.csv")[-1]
    whole = next(r for r in read(GOLDENS / "drqn_run_24_frames.csv") if r["frames"] == 20)
    learned = [name for name in whole if not name.startswith("eval/")]
    assert [row[n] for n in learned] == pytest.approx([whole[n] for n in learned], rel=1e-5)


def test_an_exported_policy_is_the_best_one_and_small(stored: Path, tmp_path: Path) -> None:
    config = (stored / "config.yaml").read_text()
    longer = config.replace("total_frames: 16", "total_frames: 40")
    (stored / "config.yaml").write_text(longer)  # of a run that was extended
    folder = export_policy(stored, tmp_path / "policies" / "drqn", revision="abc")
    exported, best = load_policy(folder), load_policy(stored)
    for one, other in zip(exported.parameters(), best.parameters(), strict=True):
        assert torch.equal(one, other)
    assert load_plan(folder)[1].task == load_plan(stored)[1].task
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    assert size < 0.2 * sum(f.stat().st_size for f in stored.rglob("*") if f.is_file())
    card = (folder / "README.md").read_text()
    assert all(words in card for words in ("Predation", "DRQN", "abc", "| success rate |"))
    assert longer != config and " of 40" in card
    with pytest.raises(ValueError, match="exists; name a new one"):
        export_policy(stored, folder)
