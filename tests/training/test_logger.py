"""Where a run writes: its folder, its numbers, its bar."""

import json
import math
import os
import time
from pathlib import Path

import pytest

from fishrl.training import complete
from fishrl.training.logger import CsvLogger, WandbLogger
from fishrl.training.run_folder import RunFolder, write_json
from tests.training.conftest import Toy, read_rows


def test_second_run_of_a_name_gets_a_number(tmp_path: Path) -> None:
    folders = [RunFolder.create(parent=str(tmp_path), name="run").path.name for _ in range(3)]
    assert folders == ["run", "run-2", "run-3"]


def test_unmeasured_metrics_are_empty_cells(tmp_path: Path) -> None:
    log = CsvLogger()
    log.open(tmp_path, columns=["frames", "train/a", "eval/b"], config={})
    log.log({"frames": 1, "train/a": 0.5})
    log.log({"frames": 2, "train/a": math.nan, "eval/b": 3.0})
    assert read_rows(tmp_path) == [
        {"frames": "1", "train/a": "0.5", "eval/b": ""},
        {"frames": "2", "train/a": "", "eval/b": "3.0"},
    ]


def test_damaged_metrics_are_refused_and_stay(tmp_path: Path) -> None:
    for content in (b"a,b\n1,2\n", b"frames,a\n1,2\nx,y\n3,4\n"):
        (tmp_path / "metrics.csv").write_bytes(content)
        with pytest.raises(ValueError, match=r"metrics\.csv: damaged .*delete it"):
            CsvLogger().open(tmp_path, columns=["frames", "a"], config={}, step=4)
        assert (tmp_path / "metrics.csv").read_bytes() == content


def test_deleted_metrics_begin_again_with_later_rows(tmp_path: Path) -> None:
    log = CsvLogger()
    log.open(tmp_path, columns=["frames", "a"], config={})
    log.log({"frames": 8, "a": 1.0})
    (tmp_path / "metrics.csv").unlink()
    log.log({"frames": 16, "a": 2.0})
    assert read_rows(tmp_path) == [{"frames": "16", "a": "2.0"}]
    (tmp_path / "metrics.csv").unlink()
    tmp_path.rmdir()
    log.log({"frames": 24, "a": 3.0})
    log.close()


def test_resumed_log_drops_rows_after_the_checkpoint(tmp_path: Path) -> None:
    log = CsvLogger()
    log.open(tmp_path, columns=["frames", "a"], config={})
    for frames in (8, 16, 24):
        log.log({"frames": frames, "a": 1.0})
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write("1")  # cut while writing
    again = CsvLogger()
    again.open(tmp_path, columns=["frames", "a"], config={}, step=16)
    again.log({"frames": 24, "a": 2.0})
    rows = read_rows(tmp_path)
    assert [tuple(row.values()) for row in rows] == [("8", "1.0"), ("16", "1.0"), ("24", "2.0")]


def test_wandb_writes_offline(toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_SILENT", "true")
    before = dict(os.environ)
    complete(toy.begin(name="run", total_frames=80, logger=WandbLogger(is_offline=True)))
    folder = tmp_path / "run"
    deadline = time.monotonic() + 300.0  # wandb's own process writes when it gets round to it
    recorded: list[Path] = []
    while not (recorded and b"train/return" in recorded[0].read_bytes()):
        assert time.monotonic() < deadline, "wandb wrote no metrics"
        time.sleep(0.1)
        recorded = list(folder.glob("wandb/offline-run-*/*.wandb"))
    assert len(recorded) == 1
    assert (folder / "wandb_id").read_text() in recorded[0].name
    assert len(read_rows(folder)) == 2
    assert os.environ.get("WANDB_MODE") == before.get("WANDB_MODE")


def test_resumed_run_keeps_its_wandb_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_SILENT", "true")
    with monkeypatch.context() as agent:
        agent.setenv("WANDB_SWEEP_ID", "sweepid")
        agent.setenv("WANDB_RUN_ID", "agentsid")
        open_and_close(tmp_path)
    open_and_close(tmp_path)  # resumed without the agent
    assert (tmp_path / "wandb_id").read_text() == "agentsid"
    recorded = tmp_path.glob("wandb/offline-run-*/*.wandb")
    assert {path.name for path in recorded} == {"run-agentsid.wandb"}


def test_wandb_has_its_mode_and_key(
    toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WANDB_SILENT", "true")
    for name, value in (("HOME", str(tmp_path)), ("NETRC", str(tmp_path / "none"))):
        monkeypatch.setenv(name, value)  # without the user's key
    monkeypatch.delenv("WANDB_API_KEY", raising=False)
    for refused in (
        lambda: open_and_close(tmp_path, is_offline=False),
        lambda: toy.begin(name="run", logger=WandbLogger()),
    ):
        with pytest.raises(ValueError, match=r"^Weights & Biases: No API key .*; or set logger"):
            refused()
    assert not (tmp_path / "run").exists()
    for mode, num_recorded in (("disabled", 0), ("offline", 1)):
        monkeypatch.setenv("WANDB_MODE", mode)
        open_and_close(tmp_path, is_offline=False)
        assert len([*tmp_path.glob("wandb/offline-run-*")]) == num_recorded


def open_and_close(folder: Path, *, is_offline: bool = True) -> None:
    import wandb

    wandb.teardown()  # as in a new process, which reads the variables
    logger = WandbLogger(is_offline=is_offline)
    logger.open(folder, columns=["frames"], config={})
    logger.close()


def test_nan_and_infinity_become_null_in_json(tmp_path: Path) -> None:
    nested = {"a": math.nan, "b": [1.5, {"c": -math.inf}], "d": "x", "e": (math.inf, 2)}
    write_json(tmp_path / "summary.json", nested)
    written = json.loads((tmp_path / "summary.json").read_text())
    assert written == {"a": None, "b": [1.5, {"c": None}], "d": "x", "e": [None, 2]}
