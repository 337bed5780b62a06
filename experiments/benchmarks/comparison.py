"""Protocol of the comparison: one process per code, short bursts in turn, each case once per round.

Other load on the machine slows all cases of a round, so speeds are compared round by round. While
one process measures, the others wait. A burst starts after the threads of the previous one sleep,
with untimed steps that fill the caches and wake its own threads.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from typing import Any

import torch
from tqdm import tqdm

from fishrl.bounds import bounded, check_bounds

logger = logging.getLogger(__name__)
_PAUSE = 0.01  # seconds; threads of GNU's OpenMP were seen to spin for four milliseconds
_WARM_UP = 4  # such a part of a burst runs before it and is not timed

KERNEL = "kernel"  # the pass over all nodes alone, without edges
PERIODIC = "periodic"  # a whole step with periodic edges
WALLS = "with walls"  # a whole step with boundary conditions on all four sides
FISH = "with fish"  # the same with a swimming fish in each flow
PROBE = "memory"  # no flow: the speed of the memory


@dataclass(frozen=True, kw_only=True)
class BenchmarkSettings:
    """What to measure, and where to write it.

    Args:
        body_length: L of the large case, whose tank is 10 L x 5 L; others have L / 2 and L / 4.
        threads: cores that each code may use.
        rounds: bursts of every case.
        burst: seconds that a burst should take.
        groups: groups of measurements; by default all.
        folder: of results and figures.
        docs: folder of pages to write stored results of ``folder`` into; nothing is measured.
    """

    body_length: int = bounded(100, least=80)  # a fish has at least 16 nodes, also in a small case
    threads: int = bounded(os.cpu_count() or 1, least=1)
    rounds: int = bounded(15, least=2)
    burst: float = bounded(0.1, greater=0.0)
    groups: tuple[str, ...] = ()
    folder: str = "runs/benchmark"
    docs: str | None = None

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)
        if self.body_length % 4:
            raise ValueError(f"body_length = {self.body_length}: must be a multiple of 4")

    @property
    def cores(self) -> str:
        """Number of threads, in words."""
        return f"{self.threads} threads" if self.threads > 1 else "one core"


@dataclass(kw_only=True)
class Row:
    """A case and its times.

    Attributes:
        label: by which targets and figures find it, such as "large/walls".
        name: the case in words.
        scope: how much of a step it is: kernel, periodic, with walls, with fish.
        num_nodes: node updates of one step, all flows together.
        working_set: bytes that a step goes through.
        bytes_per_update: that a node update moves if each population is read and written once.
        num_steps: of each burst. None: as many as fill one. 0: no bursts, ``facts`` hold all.
        facts: numbers known before the bursts.
        code, group: of the job.
        seconds: that one step took, by round.
        extras: further numbers of each burst, by round.
    """

    label: str
    name: str
    scope: str = ""
    num_nodes: int = 0
    working_set: int = 0
    bytes_per_update: int = 72
    num_steps: int | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    code: str = ""
    group: str = ""
    seconds: list[float] = field(default_factory=list)
    extras: dict[str, list[float]] = field(default_factory=dict)


@dataclass(kw_only=True)
class Case(Row):
    """A case and how to run it.

    Attributes:
        advance: runs so many steps, and may return further numbers.
        multiple: the numbers of steps it can run are multiples of this.
        prepare: is called before each burst and not timed.
    """

    advance: Callable[[int], dict[str, float] | None] = lambda num_steps: None
    multiple: int = 1
    prepare: Callable[[], object] = lambda: None


@dataclass(frozen=True)
class Job:
    """The cases of one process.

    Args:
        group: by which it is chosen.
        make: a function at the top of a module, run in that process; an ImportError means that the
            code is not installed.
        code: whose code it is.
        is_long: whether bursts take seconds, or everything is measured once. Such jobs have rounds
            of their own, and are prepared one after the other.
    """

    group: str
    make: Callable[[BenchmarkSettings], Sequence[Case]]
    code: str = "fishrl"
    is_long: bool = False


@dataclass(frozen=True, kw_only=True)
class Skipped:
    """A job without results: its code is not installed, or has failed."""

    code: str
    group: str
    why: str
    has_failed: bool


def start_process() -> ProcessPoolExecutor:
    """Return a new process; it is spawned, as a fork of one with threads may hang."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))


class _Process:
    """The process of a job, as seen from outside."""

    def __init__(self, job: Job) -> None:
        self.job, self.pool = job, start_process()
        self.rows: list[Row] = []
        self.skipped: Skipped | None = None

    def prepare(self, settings: BenchmarkSettings) -> None:
        logger.info("%s: preparing %s ...", self.job.group, self.job.code)
        self.rows = self._call(_prepare, self.job, settings) or []

    def measure(self) -> None:
        for index, row in enumerate(self.rows):
            if row.num_steps and self.skipped is None:
                time.sleep(_PAUSE)
                if burst := self._call(_measure, index, row.num_steps):
                    seconds, extras = burst
                    row.seconds.append(seconds)
                    for name, value in extras.items():
                        row.extras.setdefault(name, []).append(value)

    def _call(self, function: Callable[..., Any], *arguments: object) -> Any:
        """Return what the process answers; if it fails, drop its rows and return None."""
        try:
            return self.pool.submit(function, *arguments).result()
        except Exception as problem:  # whatever it is, the other jobs go on
            is_absent = isinstance(problem, ImportError)
            why = str(problem) if is_absent else f"{type(problem).__name__}: {problem}"
            code, group = self.job.code, self.job.group
            logger.warning("%s: %s is left out: %s", group, code, why, exc_info=not is_absent)
            self.rows = []
            self.skipped = Skipped(code=code, group=group, why=why, has_failed=not is_absent)
            return None


def compare_codes(
    jobs: Sequence[Job], settings: BenchmarkSettings, *, num_parallel: int = 1
) -> tuple[list[Row], list[Skipped]]:
    """Time all cases of all jobs in turn.

    Args:
        jobs: one process each.
        settings: rounds and length of the bursts.
        num_parallel: jobs that are prepared at the same time, as they may compile.

    Returns:
        A row per case, and the jobs that could not take part.
    """
    processes = [_Process(job) for job in jobs]
    try:
        with ThreadPoolExecutor(num_parallel) as threads:
            list(threads.map(lambda process: process.prepare(settings), processes))
        for _ in tqdm(range(settings.rounds), desc="rounds", disable=None):
            for process in processes:
                process.measure()
    finally:
        for process in processes:
            process.pool.shutdown()
    rows = [row for process in processes for row in process.rows]
    return rows, [process.skipped for process in processes if process.skipped]


_cases: list[Case] = []  # of this process


def _prepare(job: Job, settings: BenchmarkSettings) -> list[Row]:
    torch.set_num_threads(settings.threads)
    _cases.extend(job.make(settings))
    rows = []
    for case in _cases:
        known = {each.name: getattr(case, each.name) for each in fields(Row)}
        if case.num_steps is None:
            known["num_steps"] = find_length(case, settings.burst)
        elif case.num_steps:
            time_burst(case, case.num_steps)  # the first may compile
        rows.append(Row(**known | {"code": job.code, "group": job.group}))
    return rows


def _measure(index: int, num_steps: int) -> tuple[float, dict[str, float]]:
    return time_burst(_cases[index], num_steps)


def time_burst(case: Case, num_steps: int) -> tuple[float, dict[str, float]]:
    """Return the seconds of one step, and further numbers of the burst."""
    case.prepare()
    if case.num_steps is None:
        case.advance(max(1, num_steps // _WARM_UP // case.multiple) * case.multiple)
        _synchronize()
    start = time.perf_counter()
    extras = case.advance(num_steps)
    _synchronize()
    return (time.perf_counter() - start) / num_steps, extras or {}


def _synchronize() -> None:
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()


def find_length(case: Case, burst: float) -> int:
    """Return how many steps fill a burst of some seconds."""
    num_steps = case.multiple
    time_burst(case, num_steps)  # the first run may compile, or touch memory for the first time
    while True:
        spent = time_burst(case, num_steps)[0] * num_steps
        if spent >= 0.5 * burst or num_steps >= 1_000_000:
            return max(1, round(num_steps * burst / spent / case.multiple)) * case.multiple
        num_steps = 2 * num_steps
