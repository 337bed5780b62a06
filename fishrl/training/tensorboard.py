"""A logger for TensorBoard."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fishrl.extras import needing
from fishrl.training.logger import CsvLogger


class TensorboardLogger(CsvLogger):
    """TensorBoard's event files in the run folder, in addition to the CSV file.

    ``check`` raises ImportError if tensorboard is not installed.
    """

    _writer: Any = None

    def check(self) -> None:
        """Import tensorboard."""
        with needing("tensorboard", "logger=tensorboard"):
            import torch.utils.tensorboard  # noqa: F401

    def _begin(self, folder: Path, *, config: Mapping[str, Any], step: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        # later steps of earlier files are hidden
        self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1)

    def _send(self, measured: Mapping[str, float], *, step: int) -> None:
        for name, value in measured.items():
            if name != self._columns[0]:
                self._writer.add_scalar(name, value, step)
        self._writer.flush()

    def _end(self) -> None:
        if self._writer is not None:
            self._writer.close()
