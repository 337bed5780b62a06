"""TensorBoard reads what the logger wrote, also after a resume."""

import math
import sys
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from fishrl.settings import build, describe
from fishrl.training.logger import CsvLogger
from fishrl.training.tensorboard import TensorboardLogger

COLUMNS = ["frames", "train/return", "eval/return"]


def write(folder: Path, *rows: tuple[int, float, float], step: int = 0) -> list[tuple[int, float]]:
    """Log rows of frames and returns; return what TensorBoard shows of the return in training."""
    logger = TensorboardLogger()
    logger.open(folder, columns=COLUMNS, config={}, step=step)
    for row in rows:
        logger.log(dict(zip(COLUMNS, row, strict=True)))
    logger.close()
    events = EventAccumulator(str(folder / "tensorboard")).Reload()
    return [(event.step, event.value) for event in events.Scalars("train/return")]


def test_tensorboard_reads_every_step_once_also_after_a_resume(tmp_path: Path) -> None:
    write(tmp_path, (10, 1.0, math.nan), (20, 2.0, 0.5), (30, 3.0, math.nan))
    assert write(tmp_path, (40, 7.0, 1.0), step=20) == [(10, 1.0), (20, 2.0), (40, 7.0)]
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [event.step for event in events.Scalars("eval/return")] == [20, 40]
    rows = (tmp_path / "metrics.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["frames", "10", "20", "40"]
    assert write(tmp_path, (10, 2.0, 0.0)) == [(10, 2.0)]  # begun again


def test_run_is_read_without_tensorboard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    logger = build(CsvLogger, describe(TensorboardLogger()))
    with pytest.raises(ImportError, match="logger=tensorboard needs packages: pip install"):
        logger.check()
