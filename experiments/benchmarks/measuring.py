"""The measuring loop: short bursts of all cases in turn, each case once per round.

Other load on the machine slows all cases of a round, so speeds are compared round by round. A burst
starts after the threads of the previous one sleep, with untimed steps that fill the caches and wake
its own threads.
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
_WARM_UP = 4  # such a part of a burst runs before it and is not timed

KERNEL = "kernel"  # the pass over all nodes alone, without edges
PERIODIC = "periodic"  # a whole step with periodic edges
WALLS = "with walls"  # a whole step with boundary conditions on all four sides
FISH = "with fish"  # the same with a swimming fish in each flow
PROBE = "memory"  # no flow: the speed of the memory


class BenchmarkSettings(Settings):
    """What to measure, and where to write it.

    Args:
        body_length: L of the large case, whose tank is 10 L x 5 L; others have L / 2 and L / 4.
        threads: cores to use.
        rounds: number of bursts of every case.
        burst: seconds that a burst should take.
        groups: groups of measurements; by default all.
        folder: folder of results and figures.
        docs: folder of the page that the results are also put into.
    """

    body_length: Annotated[int, Field(ge=80)] = 100  # at least 16 nodes in a small case too
    threads: PositiveInt = count_cores()
    rounds: Annotated[int, Field(ge=2)] = 15
    burst: PositiveFloat = 0.1
    groups: tuple[str, ...] = ()
    folder: str = "runs/benchmark"
    docs: str | None = None

    @property
    def cores(self) -> str:
        """Number of threads, in words."""
        return f"{self.threads} threads" if self.threads > 1 else "one core"


@dataclass(kw_only=True)
class Case:
    """What is advanced, and what was measured."""

    label: str  #: by which goals and figures find it, such as "large/walls"
    name: str  #: the case in words
    advance: Any = None  #: runs so many steps, and may return further numbers ``dict[str, float]``
    prepare: Any = None  #: is called before each burst and not timed
    scope: str = ""  #: how much of a step it is: kernel, periodic, with walls, with fish
    num_nodes: int = 0  #: node updates of one step, all flows together
    working_set: int = 0  #: bytes that a step goes through
    #: bytes that a node update moves if each population is read and written once
    bytes_per_update: int = 72
    num_steps: int | None = None  #: of a burst; None: an even number that fills it; 0: no bursts
    facts: dict[str, Any] = field(default_factory=dict)  #: numbers known in advance, and words
    #: by round, "seconds" of one step and further numbers
    measured: dict[str, list[float]] = field(default_factory=dict)
    group: str = ""  #: the group of measurements


@dataclass(kw_only=True)
class Results:
    """Everything that a run has found."""

    machine: dict[str, Any]
    settings: dict[str, Any]
    cases: list[Case] = field(default_factory=list)

    def find(self, label: str) -> Case | None:
        """Return the case with a label if it was measured."""
        return next((case for case in self.cases if case.label == label), None)

    def of_group(self, group: str) -> list[Case]:
        """Return the cases of a group."""
        return [case for case in self.cases if case.group == group]

    def save(self, path: Path) -> None:
        """Write everything as JSON."""
        cases = [vars(case) | {"advance": None, "prepare": None} for case in self.cases]
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(vars(self) | {"cases": cases}, indent=1))


def measure(cases: Sequence[Case], settings: BenchmarkSettings) -> None:
    """Time all cases in turn."""
    lengths = [
        find_length(case, settings.burst) for case in tqdm(cases, desc="preparing", disable=None)
    ]
    for _ in tqdm(range(settings.rounds), desc="rounds", disable=None):
        for case, num_steps in zip(cases, lengths, strict=True):
            for name, value in time_burst(case, num_steps).items() if num_steps else ():
                case.measured.setdefault(name, []).append(value)


def time_burst(case: Case, num_steps: int) -> dict[str, float]:
    """Return the seconds of one step, and further numbers of the burst."""
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


def find_length(case: Case, burst: float) -> int:
    """Return how many steps fill a burst of some seconds."""
    num_steps = 2 if case.num_steps is None else case.num_steps
    if num_steps:
        time_burst(case, num_steps)  # may compile, or touch memory for the first time
    while case.num_steps is None:
        spent = time_burst(case, num_steps)["seconds"] * num_steps
        if spent >= 0.5 * burst or num_steps >= 1_000_000:
            return max(2, round(num_steps * burst / spent / 2) * 2)
        num_steps = 2 * num_steps
    return num_steps


def repeat(*calls: Callable[[], object]) -> Callable[[int], None]:
    """Return what makes one of some calls per step, in turn."""

    def advance(num_steps: int) -> None:
        for _ in range(num_steps // len(calls)):
            for call in calls:
                call()

    return advance
