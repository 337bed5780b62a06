"""Loggers of metrics: a CSV file, and optionally Weights & Biases."""

import csv
import io
import logging
import math
import os
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fishrl.files import write_whole

logger = logging.getLogger(__name__)


def read_rows(path: Path) -> list[dict[str, str]]:
    """Read a ``metrics.csv``, numbers and blanks, without a last row that a kill has cut.

    Raises:
        ValueError: naming the file if it has no column ``frames`` or a row without a number there.
    """
    with path.open(newline="", encoding="utf-8") as file:
        lines = csv.DictReader(file)
        names = lines.fieldnames or ()
        rows = [row for row in lines if None not in (*row, *row.values())]
    if "frames" not in names or not all(r["frames"].isdecimal() for r in rows):
        raise ValueError(f"{path}: damaged (it lacks frames); repair or delete it")
    return rows


class CsvLogger:
    """One row per log step, one column per metric; unmeasured metrics are left empty.

    Rows that cannot be written, as when the disk is full, are kept for the next time.
    """

    _path: Path | None = None

    def check(self) -> None:
        """Raise ValueError or ImportError, before all that is slow, for what ``open`` lacks."""

    def open(
        self, folder: Path, *, columns: Sequence[str], config: Mapping[str, Any], step: int = 0
    ) -> None:
        """Start ``metrics.csv``, or continue it after ``step`` > 0 and drop later rows.

        ``columns`` are every metric there will be, the step first; ``config`` is the whole
        configuration.
        """
        self._begin(folder, config=config, step=step)
        self._path, self._columns = folder / "metrics.csv", list(columns)
        self._unwritten: list[dict[str, Any]] = []
        self._heads = {name: name for name in columns}
        rows: list[Mapping[str, Any]] = [self._heads]
        if step > 0 and self._path.is_file():
            rows += [row for row in read_rows(self._path) if int(row["frames"]) <= step]
        write_whole(self._path, self._render(rows))

    def log(self, metrics: Mapping[str, float]) -> None:
        """Add a row; raise ValueError for a metric that is not among the columns."""
        unknown = sorted(set(metrics) - set(self._columns))
        if unknown:
            raise ValueError(f"metrics {unknown}: not among the columns {self._columns}")
        measured = {name: value for name, value in metrics.items() if not math.isnan(value)}
        self._unwritten.append(measured)
        self._write()
        self._send(measured, step=int(metrics[self._columns[0]]))

    def close(self) -> None:
        """Close the log, and try again to write the rows that could not be written."""
        self._write()
        self._end()

    def _begin(self, folder: Path, *, config: Mapping[str, Any], step: int) -> None:
        """Begin wherever else a subclass logs; arguments as for ``open``."""

    def _send(self, measured: Mapping[str, float], *, step: int) -> None:
        """Send a row there."""

    def _end(self) -> None:
        """End there."""

    def _write(self) -> None:
        """Append the rows that are not written yet, all of them or none."""
        if self._path is None or not self._unwritten:
            return
        try:
            with self._path.open("ab", buffering=0) as file:
                size = file.tell()
                heads = [] if size else [self._heads]  # the file may have been deleted
                text = self._render([*heads, *self._unwritten]).encode()
                if file.write(text) < len(text):
                    file.truncate(size)
                    raise OSError("the disk is full")
        except OSError as error:
            reason = error.strerror or error
            count = len(self._unwritten)
            logger.error("%s: %d rows cannot be written (%s)", self._path, count, reason)
        else:
            self._unwritten = []

    def _render(self, rows: Sequence[Mapping[str, Any]]) -> str:
        text = io.StringIO(newline="")
        csv.DictWriter(text, self._columns, restval="", extrasaction="ignore").writerows(rows)
        return text.getvalue()


class WandbLogger(CsvLogger):
    """Weights & Biases in addition to the CSV file.

    Args:
        project: project of Weights & Biases.
        is_offline: write below the run folder and upload nothing; ``wandb sync`` does so later.
            Otherwise the variable ``WANDB_MODE`` decides.

    ``check`` and ``open`` raise ValueError where Weights & Biases refuses, as without an API key.
    """

    _run: Any = None

    def __init__(self, *, project: str = "fishrl", is_offline: bool = False) -> None:
        self.project, self.is_offline = project, is_offline

    def check(self) -> None:
        """Log in, unless nothing is uploaded."""
        import wandb

        if not self.is_offline and os.environ.get("WANDB_MODE", "online") == "online":
            with _refusing():
                wandb.login()

    def _begin(self, folder: Path, *, config: Mapping[str, Any], step: int) -> None:
        import wandb

        identity = folder / "wandb_id"  # which a resumed run keeps
        with _refusing():
            self._run = wandb.init(
                project=self.project,
                name=folder.name,
                id=identity.read_text("utf-8") if identity.is_file() else uuid.uuid4().hex[:12],
                dir=str(folder),
                config=dict(config),
                mode="offline" if self.is_offline else None,
                resume="allow",
                settings=wandb.Settings(console="off"),  # or it would log the bar's moves
            )
        write_whole(identity, self._run.id)  # an agent has its own

    def _send(self, measured: Mapping[str, float], *, step: int) -> None:
        self._run.log(measured, step=step)

    def _end(self) -> None:
        if self._run is not None:
            self._run.finish()  # else the next one in this process would be the same


@contextmanager
def _refusing() -> Iterator[None]:
    import wandb

    try:
        yield
    except wandb.errors.Error as error:
        said = str(error).strip().rstrip(".")
        raise ValueError(
            f"Weights & Biases: {said}; or set logger.is_offline=true, or WANDB_MODE=offline"
        ) from error
