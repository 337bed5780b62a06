"""What the project wants to reach, and whether it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from experiments.benchmarks.results import Results, Row, Spread, compare, spread

MET, MISSED, UNKNOWN = "met", "missed", "not measured"

IN_PLACE = ("lbmpy/aa", "lbmpy/esotwist")
TWO_BUFFERS = ("lbmpy/pull, periodic",)


@dataclass(frozen=True, kw_only=True)
class Goal:
    """One number and its bar.

    Args:
        what: is measured.
        bar: to be reached.
        is_floor: whether the number should be at least the bar, not at most.
        measure: returns the number, or None where something it needs was not measured.
        unit: of number and bar.
    """

    what: str
    bar: float
    is_floor: bool
    measure: Callable[[Results], Spread | None]
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A goal and what was found."""

    goal: Goal
    found: Spread | None

    @property
    def word(self) -> str:
        """Met or missed by the median, or not measured."""
        if self.found is None:
            return UNKNOWN
        gap = self.found.median - self.goal.bar
        return MET if (gap >= 0.0 if self.goal.is_floor else gap <= 0.0) else MISSED


def at_least(bar: float, ours: str, theirs: Sequence[str], against: str) -> Goal:
    """Return the goal to be ``bar`` times as fast per node update as the fastest of some rows."""

    def measure(results: Results) -> Spread | None:
        row, others = results.find(ours), find_rows(results, theirs)
        if row is None or not others:
            return None
        return compare(row, max(others, key=lambda other: other.mlups.median))

    return Goal(what=against, bar=bar, is_floor=True, measure=measure, unit="×")


def at_most(bar: float, what: str, unit: str, read: Callable[[Results], float | None]) -> Goal:
    """Return the goal that one number stays below a bar."""

    def measure(results: Results) -> Spread | None:
        value = read(results)
        return None if value is None else Spread(value, value, value)

    return Goal(what=what, bar=bar, is_floor=False, measure=measure, unit=unit)


def find_rows(results: Results, labels: Sequence[str]) -> list[Row]:
    """Return those of some rows that were measured."""
    return [row for row in map(results.find, labels) if row is not None]


def measure_overhead(results: Results) -> Spread | None:
    """Return how many percent of a whole environment step are not spent in the flow."""
    row = results.find("env/policy")
    return None if row is None else spread([100.0 * x for x in row.extras["share_outside_flow"]])


def read_memory(results: Results) -> float | None:
    """Return the bytes per node of the hungriest flow."""
    rows = results.studies.get("memory", {}).get("rows", [])
    return max((row["bytes_per_node"] for row in rows), default=None)


GOALS: tuple[Goal, ...] = (
    at_least(0.80, "large/walls", IN_PLACE, "flow and walls / lbmpy's in-place kernel"),
    at_least(1.8, "large/walls", TWO_BUFFERS, "flow and walls / lbmpy's two-buffer step"),
    at_least(1.6, "large/walls", ["numba/step"], "flow and walls / numba"),
    at_least(17.0, "large/walls", ["lettuce/compiled"], "flow and walls / lettuce compiled"),
    at_least(0.65, "large/fish", IN_PLACE, "one swimming fish / lbmpy's in-place kernel"),
    at_least(
        1.4, "large/fish", TWO_BUFFERS, "one swimming fish / lbmpy's two-buffer step without a body"
    ),
    at_least(
        0.50, "batch16/fish", IN_PLACE, "16 flows, a fish in each / lbmpy's in-place kernel, large"
    ),
    at_least(
        0.50,
        "batch16/fish",
        ["lbmpy/batch16"],
        "16 flows, a fish in each / lbmpy's in-place kernel, same 16 flows one by one",
    ),
    at_least(0.90, "gpu/kernel", ["gpu/copy"], "GPU, bulk / copy"),
    at_least(0.75, "gpu/fish", ["gpu/copy"], "GPU, whole step with fish / copy"),
    at_least(1.6, "gpu/fish, half", ["gpu/fish"], "GPU, stored in half / in single precision"),
    Goal(
        what="share of an environment step outside the flow",
        bar=2.0,
        is_floor=False,
        measure=measure_overhead,
        unit="%",
    ),
    at_most(45.0, "memory per node and flow", "B", read_memory),
    at_most(45.0, "compile, cold", "s", lambda r: r.studies.get("compile", {}).get("cold")),
    at_most(1.0, "compile, warm", "s", lambda r: r.studies.get("compile", {}).get("warm")),
)


def judge(results: Results, goals: Sequence[Goal] = GOALS) -> list[Verdict]:
    """Return a verdict on every goal."""
    return [Verdict(goal=goal, found=goal.measure(results)) for goal in goals]
