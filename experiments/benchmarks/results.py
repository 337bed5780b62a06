"""What was measured: rows of times, ratios of the same round, and the file that keeps them."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from experiments.command_line import show_command

VERSION = 1


class Spread(NamedTuple):
    """A median between its quartiles."""

    low: float
    median: float
    high: float


class Skipped(NamedTuple):
    """A code that could not take part, and why: it is not there, or it has failed."""

    code: str
    group: str
    why: str
    has_failed: bool


@dataclass(frozen=True, kw_only=True)
class Row:
    """The times of one entry; for the other fields see ``Entry``.

    Attributes:
        code: whose it is.
        group: of the benchmark.
        num_steps: in each burst.
        seconds: that one step took, by round.
        extras: numbers that came with the bursts, by round.
    """

    code: str
    group: str
    label: str
    name: str
    scope: str
    num_nodes: int
    working_set: int
    bytes_per_update: int
    num_steps: int
    unit: str
    seconds: tuple[float, ...]
    facts: Mapping[str, Any] = field(default_factory=dict)
    extras: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def speeds(self) -> list[float]:
        """Million node updates per second, by round."""
        return [self.num_nodes / s / 1e6 for s in self.seconds]

    @property
    def mlups(self) -> Spread:
        """Million lattice node updates per second."""
        return spread(self.speeds)

    @property
    def bandwidth(self) -> Spread:
        """GB/s that the updates move if each population is read and written once."""
        return Spread(*(1e-3 * self.bytes_per_update * s for s in self.mlups))


def spread(values: Sequence[float]) -> Spread:
    """Return the median and the quartiles of some values."""
    return Spread(*statistics.quantiles(values, n=4, method="inclusive"))


def compare(ours: Row, theirs: Row) -> Spread:
    """Return how many times faster one row is per node update, round by round.

    Raises:
        ValueError: if they were not measured in the same rounds.
    """
    if len(ours.seconds) != len(theirs.seconds):
        raise ValueError(
            f"'{ours.label}' has {len(ours.seconds)} rounds and '{theirs.label}' "
            f"{len(theirs.seconds)}: only bursts of the same rounds can be compared"
        )
    return spread([a / b for a, b in zip(ours.speeds, theirs.speeds, strict=True)])


def compare_times(ours: Row, theirs: Row) -> Spread:
    """Return how many times longer one row takes per step, round by round."""
    return spread([a / b for a, b in zip(ours.seconds, theirs.seconds, strict=True)])


@dataclass
class Results:
    """Everything that a run of the benchmark has found.

    Attributes:
        machine: what it ran on.
        settings: what was asked for.
        rows: of all contests.
        skipped: codes that could not take part.
        studies: what was measured beside the contests, by group.
    """

    machine: dict[str, Any]
    settings: dict[str, Any]
    rows: list[Row] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    studies: dict[str, Any] = field(default_factory=dict)

    def find(self, label: str) -> Row | None:
        """Return the row of a label, or None if it was not measured."""
        return next((row for row in self.rows if row.label == label), None)

    def of_group(self, group: str) -> list[Row]:
        """Return the rows of a group."""
        return [row for row in self.rows if row.group == group]

    def save(self, path: Path) -> None:
        """Write everything as JSON; medians and quartiles stand beside the times they come from."""
        plain = {
            "version": VERSION,
            "machine": self.machine,
            "settings": self.settings,
            "rows": [_plain(row) for row in self.rows],
            "skipped": [skipped._asdict() for skipped in self.skipped],
            "studies": self.studies,
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Results:
        """Read what ``save`` wrote.

        Raises:
            ValueError: if there is nothing, or something else.
        """
        command = show_command("experiments.benchmark")
        if not path.is_file():
            raise ValueError(f"{path}: no such file; run {command} first")
        try:
            plain = json.loads(path.read_text(encoding="utf-8"))
            version = plain["version"]
        except (json.JSONDecodeError, KeyError, TypeError):
            version = None
        if version != VERSION:
            raise ValueError(f"{path}: no results of version {VERSION}; run {command} again")
        derived = ("mlups", "milliseconds")
        rows = [{k: v for k, v in row.items() if k not in derived} for row in plain["rows"]]
        return cls(
            machine=plain["machine"],
            settings=plain["settings"],
            rows=[Row(**row | {"seconds": tuple(row["seconds"])}) for row in rows],
            skipped=[Skipped(**skipped) for skipped in plain["skipped"]],
            studies=plain["studies"],
        )


def _plain(row: Row) -> dict[str, Any]:
    milliseconds = [1e3 * s for s in spread(row.seconds)]
    mlups = list(row.mlups) if row.num_nodes else None
    return asdict(row) | {"milliseconds": milliseconds, "mlups": mlups}
