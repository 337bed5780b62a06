"""A logger for TensorBoard."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fishrl.extras import show_install
from fishrl.training.logger import CsvLogger


class TensorboardLogger(CsvLogger):
    """TensorBoard's event files in the run folder, in addition to the CSV file.

    ``open`` raises ImportError if tensorboard is not installed.
    """

    def __init__(self) -> None:
        super().__init__()
        self._writer: Any = None

    def open(
        self, folder: Path, *, columns: Sequence[str], config: Mapping[str, Any], step: int = 0
    ) -> None:
        """Start event files as well; after a resume, later steps of earlier files are hidden."""
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise ImportError(
                f"logger=tensorboard needs a package: {show_install('tensorboard')}; or logger=csv"
            ) from error
        super().open(folder, columns=columns, config=config, step=step)
        self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1)

    def _send(self, measured: Mapping[str, float], *, step: int) -> None:
        for name, value in measured.items():
            if name != self._columns[0]:
                self._writer.add_scalar(name, value, step)
        self._writer.flush()

    def close(self) -> None:
        """End the files."""
        super().close()
        if self._writer is not None:
            self._writer.close()
