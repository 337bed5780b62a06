"""What a validation case is: jobs to run, checks to judge them by, a figure."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any, ClassVar

from matplotlib.figure import Figure

Result = dict[str, Any]
Results = Mapping[str, Result]  # by the label of the job

PASS, MISSED, RECORDED = "pass", "MISSED", "recorded"


@dataclass(frozen=True, kw_only=True)
class Job:
    """One run of a case. It runs in a process of its own, on one thread.

    Args:
        label: what sets it apart within its case, such as "D = 40".
        function: at the top of a module, so that another process finds it; returns a dict of
            numbers, words and lists of them.
        arguments: keywords of ``function``, numbers and words likewise.
        cost: node-steps, roughly; the dearest jobs start first.
    """

    label: str
    function: Callable[..., Result]
    arguments: dict[str, Any] = field(default_factory=dict)
    cost: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what cannot be sent to another process or written down."""
        name = getattr(self.function, "__qualname__", "")
        if "<" in name or not name:
            raise ValueError(
                f"job '{self.label}': {name or self.function} is no function at the top of a "
                "module, and another process could not find it: move it there"
            )
        try:
            json.dumps(self.arguments)
        except TypeError as error:
            raise ValueError(
                f"job '{self.label}': arguments must be numbers, words and lists of them ({error})"
            ) from None


@dataclass(frozen=True, kw_only=True)
class Check:
    """One number beside its reference.

    Args:
        quantity: what it is, with its unit where it has one.
        ours: what was measured.
        reference: a number, or a range (low, high) with ``inf`` where it is open; None for what
            is measured for the record.
        source: where the reference comes from.
        tolerance: how far ``ours`` may be from the reference. None with a number: the two stand
            beside each other and nothing is judged. A range needs none: inside is right.
        is_absolute: whether error and tolerance are differences, not shares of the reference.
        resolution: of the run that ``ours`` comes from.
        refinement: the same quantity at every resolution, by its name.
        note: in one or two sentences what a reader must know; of a miss, its reason.
    """

    quantity: str
    ours: float
    reference: float | tuple[float, float] | None = None
    source: str = ""
    tolerance: float | None = None
    is_absolute: bool = False
    resolution: str = ""
    refinement: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    def __post_init__(self) -> None:
        """Refuse a range upside down and a share of nothing."""
        if isinstance(self.reference, tuple) and not self.reference[0] <= self.reference[1]:
            raise ValueError(
                f"{self.quantity}: the range {self.reference} is upside down: give (low, high)"
            )
        if self.reference == 0.0 and self.tolerance is not None and not self.is_absolute:
            raise ValueError(
                f"{self.quantity}: no share of a reference of 0 can be taken: set is_absolute=True"
            )

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
        """Pass, missed, or recorded where there is nothing to judge by."""
        if self.error is None:
            return RECORDED if isfinite(self.ours) else MISSED
        if self.tolerance is None and not isinstance(self.reference, tuple):
            return RECORDED if isfinite(self.ours) else MISSED
        return PASS if self.error <= (self.tolerance or 0.0) else MISSED


def as_range(reference: float | tuple[float, float]) -> tuple[float, float]:
    """Return both ends of a reference; a number is both."""
    return reference if isinstance(reference, tuple) else (reference, reference)


class Case(ABC):
    """A flow that somebody else has solved.

    Attributes:
        name: of its files and of ``--cases``; words joined by hyphens.
        title: heading in the report.
        source: whose numbers it is judged by.
        setup: one paragraph: domain, boundaries, scales, how long it runs, what is measured.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    setup: ClassVar[str]

    @abstractmethod
    def jobs(self, *, quick: bool) -> Sequence[Job]:
        """Return the runs; the quick ones among them, or none, if ``quick``."""

    @abstractmethod
    def judge(self, results: Results) -> Sequence[Check]:
        """Return the checks of the jobs' results, by label; quick runs give fewer results."""

    @abstractmethod
    def draw(self, results: Results) -> Figure:
        """Draw the results beside the reference."""
