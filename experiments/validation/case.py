"""The interface of a validation case: runs, checks of their results, and a figure."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any, TypeVar

from matplotlib.figure import Figure

Result = dict[str, Any]
Results = Mapping[str, Result]  # by the label of the job
Reference = float | tuple[float, float] | None
Key = TypeVar("Key", bound=Hashable)

PASS, MISSED, RECORDED = "pass", "MISSED", "recorded"


@dataclass(frozen=True)
class Job:
    """One run of a case, in a process of its own, on one thread.

    Args:
        label: unique within the case, such as "D = 40".
        function: at the top of a module, so that another process finds it; returns JSON types.
        arguments: keywords of ``function``, JSON types likewise.
        cost: node-steps, roughly; the most expensive jobs start first.
    """

    label: str
    function: Callable[..., Result]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    cost: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Check:
    """One number beside its reference.

    Args:
        quantity: what it is, with its unit where it has one.
        ours: what was measured.
        reference: a number, or a range (low, high) with ``inf`` where it is open; None for what
            is measured for the record.
        source: where the reference comes from.
        tolerance: largest accepted distance from the reference. None with a number: the two stand
            beside each other and nothing is judged. A range needs none: inside is right.
        is_absolute: whether error and tolerance are differences, not shares of the reference.
        resolution: of the run that ``ours`` comes from.
        refinement: the same quantity at every resolution, by its name.
        note: in one or two sentences what a reader must know; of a miss, its reason.
    """

    quantity: str
    ours: float
    reference: Reference = None
    source: str = ""
    tolerance: float | None = None
    is_absolute: bool = False
    resolution: str = ""
    refinement: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    @property
    def error(self) -> float | None:
        """Distance from the reference, or from the near end of its range; None without one."""
        if self.reference is None:
            return None
        low, high = as_range(self.reference)
        if not isfinite(self.ours):
            return inf
        distance = max(low - self.ours, self.ours - high, 0.0)
        if self.is_absolute or distance == 0.0:
            return distance
        near = low if self.ours < low else high
        return distance / abs(near) if near else inf

    @property
    def verdict(self) -> str:
        """Pass, missed, or recorded where there is no acceptance criterion."""
        is_range = isinstance(self.reference, tuple)
        if self.error is None or (self.tolerance is None and not is_range):
            return RECORDED if isfinite(self.ours) else MISSED
        return PASS if self.error <= (self.tolerance or 0.0) else MISSED


def as_range(reference: float | tuple[float, float]) -> tuple[float, float]:
    """Return both ends of a reference; a number is both."""
    return reference if isinstance(reference, tuple) else (reference, reference)


def check_finest(
    quantity: str,
    values: Mapping[int, float],
    reference: Reference = None,
    source: str = "",
    tolerance: float | None = None,
    *,
    symbol: str,
    is_absolute: bool = False,
    note: str = "",
) -> Check:
    """Return the check of a quantity at its finest resolution, with the others beside it.

    ``values`` are by number of nodes, which ``symbol`` stands for; the rest is that of ``Check``.
    """
    return Check(
        quantity=quantity,
        ours=values[max(values)],
        reference=reference,
        source=source,
        tolerance=tolerance,
        is_absolute=is_absolute,
        resolution=f"{symbol} = {max(values)}",
        refinement={f"{symbol} = {n}": value for n, value in values.items()},
        note=note,
    )


@dataclass(frozen=True)
class Case:
    """A flow with a known solution or published results; a module of this package defines it.

    Args:
        name: of its files, and on the command line; words joined by hyphens.
        text: docstring of the module: the title, then in one paragraph the set-up (domain,
            boundaries, scales, duration, what is measured); both go into the report.
        source: of the reference values.
        make_jobs: returns the runs; if its argument is true, the quick ones among them, or none.
        judge: returns the checks of the results by label; quick runs give fewer results.
        draw: draws the results beside the reference.
    """

    name: str
    text: str | None
    source: str
    make_jobs: Callable[[bool], Sequence[Job]]
    judge: Callable[[Results], Sequence[Check]]
    draw: Callable[[Results], Figure]

    @property
    def title(self) -> str:
        """Heading in the report."""
        return (self.text or "").split("\n")[0].removesuffix(".")

    @property
    def setup(self) -> str:
        """Set-up, as one line."""
        return " ".join((self.text or "").partition("\n")[2].split())


def select(results: Results, labels: Mapping[Key, str]) -> dict[Key, Result]:
    """Return the results that are known among ``labels``, by its keys."""
    return {key: results[label] for key, label in labels.items() if label in results}
