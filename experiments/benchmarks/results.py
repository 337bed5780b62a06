"""What was measured: rows of times, ratios of the same round, and the file that keeps them."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from experiments.benchmarks.comparison import Row, Skipped


class Spread(NamedTuple):
    """A median between its quartiles."""

    low: float
    median: float
    high: float

    def show(self, digits: int = 2, scale: float = 1.0) -> str:
        """Return them times a number, such as "1.80 [1.79, 1.81]"; one number where they agree."""
        low, median, high = (f"{scale * value:.{digits}f}" for value in self)
        return median if low == median == high else f"{median} [{low}, {high}]"


def spread(values: Sequence[float]) -> Spread:
    """Return the median and the quartiles of some values."""
    return Spread(*statistics.quantiles(values, n=4, method="inclusive"))


def measure_speed(row: Row) -> Spread:
    """Return million node updates per second (MLUPS)."""
    return spread([row.num_nodes / seconds / 1e6 for seconds in row.seconds])


def compare(ours: Row, theirs: Row) -> Spread:
    """Return how many times faster one row is per node update, round by round."""
    pairs = zip(ours.seconds, theirs.seconds, strict=True)
    return spread([b / a * ours.num_nodes / theirs.num_nodes for a, b in pairs])


def read(row: Row, name: str) -> Spread | None:
    """Return a fact, the seconds of a step or another number of each burst; None without any."""
    if name in row.facts:
        return Spread(*[row.facts[name]] * 3)
    values = row.seconds if name == "seconds" else row.extras.get(name)
    return spread(values) if values else None


@dataclass(kw_only=True)
class Results:
    """Everything that a run of the benchmark has found.

    Attributes:
        machine: that it ran on.
        settings: of the run.
        rows: of all measurements.
        skipped: codes that could not take part.
    """

    machine: dict[str, Any]
    settings: dict[str, Any]
    rows: list[Row] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)

    def find(self, label: str) -> Row | None:
        """Return the row of a label, or None if it was not measured."""
        return next((row for row in self.rows if row.label == label), None)

    def of_group(self, *groups: str) -> list[Row]:
        """Return the rows of some groups."""
        return [row for group in groups for row in self.rows if row.group == group]

    def save(self, path: Path) -> None:
        """Write everything as JSON."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Results:
        """Read what ``save`` wrote."""
        plain = json.loads(path.read_text(encoding="utf-8"))
        rows = [Row(**row) for row in plain.pop("rows")]
        return cls(rows=rows, skipped=[Skipped(**each) for each in plain.pop("skipped")], **plain)
