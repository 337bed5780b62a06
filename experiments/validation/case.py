"""A validation case: its runs, checks of their results, and a figure."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from math import inf, isfinite
from typing import Any

from matplotlib.figure import Figure

Result = dict[str, Any]
Range = tuple[float, float]

PASS, MISSED, RECORDED = "pass", "MISSED", "recorded"


@dataclass(frozen=True)
class Job:
    """One run of a case, in a separate process with one thread.

    Args:
        function: top-level function of a module; returns JSON types.
        arguments: keyword arguments of ``function``, of JSON types; unique within the case.
        cost: approximate node-steps; the most expensive jobs start first.
        is_quick: whether the job belongs to the quick runs.
    """

    function: Callable[..., Result]
    arguments: dict[str, Any] = field(default_factory=dict)
    cost: float = 1.0
    is_quick: bool = False

    @property
    def label(self) -> str:
        """The call, such as ``drive_cavity(size=64)``."""
        return (
            f"{self.function.__name__}({', '.join(f'{k}={v}' for k, v in self.arguments.items())})"
        )

    @property
    def defaults(self) -> dict[str, Any]:
        """Default values of the arguments."""
        parameters = inspect.signature(self.function).parameters
        return {name: parameter.default for name, parameter in parameters.items()}


@dataclass(frozen=True)
class Runs:
    """Finished runs of a case, found by arguments, which have the defaults of the function."""

    finished: Sequence[tuple[Job, Result]]

    def by(self, name: str, **arguments: Any) -> dict[Any, Result]:
        """Return the runs with ``arguments`` by their value of the argument ``name``."""
        found = {}
        for job, result in self.finished:
            given = job.defaults | job.arguments
            if name in given and given == job.defaults | arguments | {name: given[name]}:
                found[given[name]] = result
        return found

    def read(self, key: str, name: str, **arguments: Any) -> dict[Any, Any]:
        """Return one entry of the results of ``by``."""
        return {value: run[key] for value, run in self.by(name, **arguments).items()}

    def get(self, **arguments: Any) -> Result:
        """Return the run with these arguments."""
        name, value = next(iter(arguments.items()))
        return self.by(name, **arguments)[value]


@dataclass(frozen=True)
class Check:
    """One number and its reference.

    Args:
        quantity: what it is, with its unit where it has one.
        ours: what was measured.
        reference: a number, or a range (low, high) with ``inf`` where it is open; None for what
            is measured for the record.
        source: where the reference comes from.
        tolerance: largest accepted distance from the reference. None with a number: there is no
            criterion. A range needs none: inside passes.
        is_absolute: whether error and tolerance are differences, not shares of the reference.
        resolution: of the run that ``ours`` comes from.
        refinement: the same quantity at every resolution, by its name.
        note: in one or two sentences what a reader must know; of a miss, its reason.
    """

    quantity: str
    ours: float
    reference: float | Range | None = None
    source: str = ""
    tolerance: float | None = None
    _: KW_ONLY
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


def as_range(reference: float | Range) -> Range:
    """Return both ends of a reference; a number is both."""
    return reference if isinstance(reference, tuple) else (reference, reference)


def check_refined(
    symbol: str, quantity: str, values: Mapping[Any, float], *criterion: Any, **options: Any
) -> Check:
    """Return the check of a quantity at one of its resolutions, with all in the refinement.

    Args:
        symbol: of the resolution, such as "N"; empty where ``values`` has whole names.
        quantity: what it is.
        values: the quantity by resolution.
        criterion: reference, source and tolerance, as of ``Check``.
        options: ``at``, the resolution of the check, by default the finest; others of ``Check``.
    """
    at = options.pop("at", None) or max(values)
    names = {n: f"{symbol} = {n}" if symbol else n for n in values}
    options["refinement"] = {names[n]: value for n, value in values.items()}
    options.setdefault("resolution", names[at])
    return Check(quantity, values[at], *criterion, **options)


@dataclass(frozen=True)
class Case:
    """A flow with a known solution or published results, defined by a module of this package.

    Args:
        name: name of the files and on the command line; words joined by hyphens.
        text: docstring of the module for the report: title, then a paragraph about the set-up
            (domain, boundaries, scales, duration, measurements).
        source: source of the reference values.
        jobs: the runs.
        judge: yields the checks of the finished runs, which may be the quick ones only.
        draw: draws results and reference into an empty figure. Axes with named lines get a legend,
            unless it draws one.
        size: width and height of the figure, inches.
        headline: quantity of the check in the summary table; by default the first check.
    """

    name: str
    text: str | None
    source: str
    jobs: Sequence[Job]
    judge: Callable[[Runs], Iterable[Check]]
    draw: Callable[[Figure, Runs], None]
    size: tuple[float, float] = (5.6, 3.8)
    headline: str = ""

    @property
    def title(self) -> str:
        """Heading in the report."""
        return (self.text or "").split("\n")[0].removesuffix(".")

    @property
    def setup(self) -> str:
        """Description of the set-up in one line."""
        return " ".join((self.text or "").partition("\n")[2].split())
