"""Rows of the table: what ``fishrl score`` writes, one JSON per policy, and their order."""

from collections.abc import Sequence
from pathlib import Path

from fishrl.benchmark.versions import FOLDER, find_version
from fishrl.settings import checked
from fishrl.training.run_folder import Count, Stored, read_plain

RANDOM = "random"


class Row(Stored):
    """The result of a policy in a split of a version."""

    policy: str  #: its name in the table
    kind: str  #: what it was scored from: baseline, run, archive or function
    task: str
    split: str
    settings: str  #: checksums of the version
    starts: str
    measure: str
    value: float  #: of the measure, the mean over the starts
    low: float  #: ends of its 95 % interval over the starts
    high: float
    metrics: dict[str, float | int | None]  #: all numbers of the evaluation
    num_stacked: Count
    num_envs: Count  #: flows that advanced together; random actions depend on it
    recognition: str | None  #: class of the source of flow labels
    differs: list[str] | None  #: settings of its training that differ; None where unknown
    trained_decisions: Count | None  #: None where unknown
    scored_decisions: Count
    cpu_seconds: float  #: of the scoring
    commit: str | None
    versions: dict[str, str]

    def describe_help(self) -> str:
        """Return what sets the policy apart: labels of the flow, other settings of its training."""
        other = f"other {', '.join(self.differs)}" if self.differs else ""
        return ", ".join(filter(None, (self.recognition, other)))


@checked
def read_row(path: Path) -> Row:
    """Read a row and compare it with its version.

    Raises:
        ValueError: if the file is damaged or belongs to other settings or starts.
    """
    row: Row = read_plain(path, Row, what="a result of fishrl score")
    version = find_version(row.task)
    wanted = (version.settings, version.starts.get(row.split), version.measure)
    if (row.settings, row.starts, row.measure) != wanted:
        raise ValueError(f"{path}: is not of {row.task} as it is frozen here; score it again")
    return row


@checked
def list_rows(task: str, split: str) -> list[Row]:
    """Return the stored rows of a split, those of random actions and controller, too."""

    def read(folder: str) -> list[Row]:
        paths = sorted((FOLDER / "scores" / folder).glob("*.json"))
        return [row for row in map(read_row, paths) if row.split == split]

    rows, references = read(task), find_version(task).references
    own = {row.policy for row in rows}
    return rows + [
        row
        for row in (read(references) if references else [])
        if row.kind == "baseline" and row.policy not in own
    ]


def find_ends(rows: Sequence[Row]) -> tuple[float, float] | None:
    """Return the values that score 0 and 1, of random actions and the version's controller.

    None where one is not stored, or the controller is not well above random actions: where their
    95 % intervals overlap.
    """
    by_name = {row.policy: row for row in rows if row.kind == "baseline"}
    low, high = by_name.get(RANDOM), by_name.get(find_version(rows[0].task).controller)
    if low is None or high is None or low.high >= high.low:
        return None
    return low.value, high.value


@checked
def rank(rows: Sequence[Row]) -> list[tuple[Row, tuple[float, float, float] | None]]:
    """Return rows from the best to the worst, each with its score and the score's interval.

    The interval is that of the row's value; the two ends of the scale count as exact.
    """
    ends = find_ends(rows) if rows else None

    def scale(row: Row) -> tuple[float, float, float] | None:
        if ends is None:
            return None
        low, high = ends
        one, two, three = ((x - low) / (high - low) for x in (row.value, row.low, row.high))
        return one, two, three

    return [(row, scale(row)) for row in sorted(rows, key=lambda row: -row.value)]


@checked
def show_table(rows: Sequence[Row], *, mark: Row | None = None) -> list[str]:
    """Return the lines of the table; ``mark`` is pointed at."""
    cells = [("  policy", "value [95 %]", "score [95 %]", "decisions", "trained with")]
    for row, score in rank(rows):
        value = _show(row.value, row.low, row.high)
        trained = "–" if row.trained_decisions is None else f"{row.trained_decisions:,}"
        name = f"{'> ' if row is mark else '  '}{row.policy}"
        cells.append((name, value, _show(*score) if score else "–", trained, row.describe_help()))
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    ]


def _show(value: float, low: float, high: float) -> str:
    return f"{value:.3g} [{low:.3g}, {high:.3g}]"
