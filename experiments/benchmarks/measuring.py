"""The measuring loop: in each round, a short burst of every benchmark.

Other load on the machine slows all benchmarks of a round, so that ratios are taken per round. A
burst begins when the threads of the previous one sleep, with untimed steps that fill the caches and
wake its threads.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import Field, PositiveFloat, PositiveInt
from tqdm import tqdm

from fishrl.files import write_whole
from fishrl.limits import count_cores
from fishrl.settings import Settings

_PAUSE = 0.01  # seconds; threads of GNU's OpenMP were seen to spin for four milliseconds
_WARM_UP = 4  # ratio of the timed to the untimed steps of a burst

KERNEL = "kernel"  # the pass over all nodes, without edges
PERIODIC = "periodic"  # a step with periodic edges
WALLS = "with walls"  # a step with boundary conditions on all four sides
FISH = "with fish"  # the same with a swimming fish in each flow
PROBE = "memory"  # the bandwidth of the memory


class BenchmarkSettings(Settings):
    """Settings of a run.

    Args:
        body_length: L of the large flow, in a tank of 10 L x 5 L; others have L / 4 to 2 L.
        threads: cores to use.
        rounds: bursts of every benchmark.
        burst: duration of a burst, seconds.
        groups: groups of benchmarks; by default all.
        presets: tasks and presets whose steps and decisions are measured.
        folder: folder for results and figures.
        docs: folder of the documentation whose page receives the results.
    """

    body_length: Annotated[int, Field(ge=80)] = 100  # L / 4 of at least 16 nodes
    threads: PositiveInt = count_cores()
    rounds: Annotated[int, Field(ge=2)] = 15
    burst: PositiveFloat = 0.1
    groups: tuple[str, ...] = ()
    presets: tuple[str, ...] = ("gait_bend", "gait_small", "predation", "paper")
    folder: str = "runs/benchmark"
    docs: str | None = None

    @property
    def cores(self) -> str:
        """Number of threads, in words."""
        return f"{self.threads} threads" if self.threads > 1 else "one core"


@dataclass(kw_only=True)
class Benchmark:
    """Steps to be timed, and the measurements."""

    label: str  #: key for goals and figures, such as "large/walls"
    name: str  #: description
    advance: Any = None  #: called with the number of steps; may return ``dict[str, float]``
    prepare: Any = None  #: called before each burst, untimed
    scope: str = ""  #: part of a step: kernel, periodic, with walls, with fish
    num_nodes: int = 0  #: node updates of one step in all flows
    num_steps: int | None = None  #: steps per burst; None fills its duration, 0 times nothing
    facts: dict[str, Any] = field(default_factory=dict)  #: properties known in advance
    #: by round: "seconds" of one step, and the numbers that ``advance`` returns
    measured: dict[str, list[float]] = field(default_factory=dict)
    group: str = ""  #: key of ``GROUPS``


@dataclass(kw_only=True)
class Results:
    """The measurements of a run."""

    machine: dict[str, Any]
    settings: dict[str, Any]
    cases: list[Benchmark] = field(default_factory=list)

    def find(self, label: str) -> Benchmark | None:
        """Return the benchmark with a label, if any."""
        return next((case for case in self.cases if case.label == label), None)

    def of_group(self, group: str) -> list[Benchmark]:
        """Return the benchmarks of a group."""
        return [case for case in self.cases if case.group == group]

    def save(self, path: Path) -> None:
        """Write the results as JSON."""
        cases = [vars(case) | {"advance": None, "prepare": None} for case in self.cases]
        write_whole(path, json.dumps(vars(self) | {"cases": cases}, indent=1))


def measure(cases: Sequence[Benchmark], settings: BenchmarkSettings) -> None:
    """Time all benchmarks in turn."""
    lengths = [
        find_length(case, settings.burst) for case in tqdm(cases, desc="preparing", disable=None)
    ]
    for _ in tqdm(range(settings.rounds), desc="rounds", disable=None):
        for case, num_steps in zip(cases, lengths, strict=True):
            for name, value in time_burst(case, num_steps).items() if num_steps else ():
                case.measured.setdefault(name, []).append(value)


def time_burst(case: Benchmark, num_steps: int) -> dict[str, float]:
    """Return the seconds of one step, and the numbers that ``advance`` returns."""
    time.sleep(_PAUSE)
    if case.prepare:
        case.prepare()
    if case.num_steps is None:
        case.advance(max(2, num_steps // _WARM_UP // 2 * 2))
        _synchronize()
    start = time.perf_counter()
    extras = case.advance(num_steps) or {}
    _synchronize()
    return {"seconds": (time.perf_counter() - start) / num_steps} | extras


def _synchronize() -> None:
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()


def find_length(case: Benchmark, burst: float) -> int:
    """Return the number of steps in a burst of ``burst`` seconds."""
    num_steps = 2 if case.num_steps is None else case.num_steps
    if num_steps:
        time_burst(case, num_steps)  # compilation and first use of memory
    while case.num_steps is None:
        spent = time_burst(case, num_steps)["seconds"] * num_steps
        if spent >= 0.5 * burst or num_steps >= 1_000_000:
            return max(2, round(num_steps * burst / spent / 2) * 2)
        num_steps = 2 * num_steps
    return num_steps


def repeat(*calls: Callable[[], object]) -> Callable[[int], None]:
    """Return a function of ``num_steps`` that makes the calls in turn, one per step."""

    def advance(num_steps: int) -> None:
        for _ in range(num_steps // len(calls)):
            for call in calls:
                call()

    return advance
