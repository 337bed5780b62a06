"""TensorBoard reads what the logger wrote, also after a resume."""

import sys
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from fishrl.settings import build, describe
from fishrl.training.logger import CsvLogger
from fishrl.training.tensorboard import TensorboardLogger

COLUMNS = ["frames", "train/return", "eval/return"]


def test_tensorboard_reads_every_step_once(tmp_path: Path) -> None:
    logger = TensorboardLogger()
    logger.open(tmp_path, columns=COLUMNS, config={})
    for frames in (10, 20, 30):
        values = {"frames": frames, "train/return": frames / 10, "eval/return": float("nan")}
        logger.log(values)
    logger.close()
    logger = TensorboardLogger()  # continues from frame 20
    logger.open(tmp_path, columns=COLUMNS, config={}, step=20)
    logger.log({"frames": 40, "train/return": 7.0, "eval/return": 1.0})
    logger.close()
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert set(events.Tags()["scalars"]) == {"train/return", "eval/return"}
    curve = [(event.step, event.value) for event in events.Scalars("train/return")]
    assert curve == [(10, 1.0), (20, 2.0), (40, 7.0)]
    rows = (tmp_path / "metrics.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["frames", "10", "20", "40"]


def test_a_run_with_event_files_is_read_without_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    logger = build(CsvLogger, describe(TensorboardLogger()))
    with pytest.raises(ImportError, match="logger=tensorboard needs a package: pip install"):
        logger.open(tmp_path, columns=COLUMNS, config={})


def test_a_run_that_goes_on_from_its_first_frame_hides_what_came_after(tmp_path: Path) -> None:
    for value in (1.0, 2.0):
        logger = TensorboardLogger()
        logger.open(tmp_path, columns=COLUMNS, config={})
        logger.log({"frames": 10, "train/return": value})
        logger.close()
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [event.value for event in events.Scalars("train/return")] == [2.0]
