"""Protocol of the benchmark: one process per code, short bursts in turn, each case once per round.

Other load on the machine slows all cases of a round, so speeds are compared round by round. While
one process measures, the others wait. A burst starts after the threads of the previous one sleep,
with untimed steps that fill the caches and wake its own threads.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
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
class Settings:
    """Settings of all measurements.

    Args:
        body_length: L of the large case, whose tank is 10 L x 5 L; others have L / 2 and L / 4.
        threads: cores that each code may use.
        rounds: bursts of every case.
        burst: seconds that a burst should take.
    """

    body_length: int = bounded(100, least=16)
    threads: int = bounded(os.cpu_count() or 1, least=1)
    rounds: int = bounded(15, least=2)
    burst: float = bounded(0.1, greater=0.0)

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)
        if self.body_length % 4:
            raise ValueError(f"body_length = {self.body_length}: must be a multiple of 4")

    @property
    def how(self) -> str:
        """Number of threads, in words."""
        return f"{self.threads} threads" if self.threads > 1 else "one core"


@dataclass(kw_only=True)
class Row:
    """A case and its times.

    Attributes:
        label: by which goals and figures find it, such as "large/walls".
        name: the case in words.
        scope: how much of a step it is: kernel, periodic, with walls, with fish.
        num_nodes: node updates of one step, all flows together.
        working_set: bytes that a step goes through.
        bytes_per_update: that a node update moves if each population is read and written once.
        num_steps: of each burst. None: as many as fill one. 0: no bursts, ``facts`` hold all.
        facts: numbers known before the bursts.
        code, group: of the team.
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
class Entry(Row):
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
class Team:
    """The cases of one process.

    Args:
        group: by which it is chosen.
        make: a function at the top of a module, run in that process; an ImportError means that the
            code is not installed.
        code: whose code it is.
        is_long: whether bursts take seconds, or everything is measured once. Such teams have
            rounds of their own, and are prepared one after the other.
    """

    group: str
    make: Callable[[Settings], Sequence[Entry]]
    code: str = "fishrl"
    is_long: bool = False


@dataclass(frozen=True, kw_only=True)
class Skipped:
    """A team without rows: its code is not installed, or has failed."""

    code: str
    group: str
    why: str
    has_failed: bool


def start_process() -> ProcessPoolExecutor:
    """Return a new process; it is spawned, as a fork of one with threads may hang."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))


class _Player:
    """The process of a team, as seen from outside."""

    def __init__(self, team: Team) -> None:
        self.team, self.process = team, start_process()
        self.rows: list[Row] = []
        self.skipped: Skipped | None = None

    def prepare(self, settings: Settings) -> None:
        logger.info("%s: preparing %s ...", self.team.group, self.team.code)
        with self._leaving_if_it_fails():
            self.rows = self.process.submit(_prepare, self.team, settings).result()

    def play(self) -> None:
        with self._leaving_if_it_fails():
            for index, row in enumerate(self.rows):
                if row.num_steps:
                    time.sleep(_PAUSE)
                    seconds, extras = self.process.submit(_play, index, row.num_steps).result()
                    row.seconds.append(seconds)
                    for name, value in extras.items():
                        row.extras.setdefault(name, []).append(value)

    @contextmanager
    def _leaving_if_it_fails(self) -> Iterator[None]:
        try:
            yield
        except Exception as problem:  # whatever it is, the other teams go on
            is_absent = isinstance(problem, ImportError)
            why = str(problem) if is_absent else f"{type(problem).__name__}: {problem}"
            code, group = self.team.code, self.team.group
            logger.warning("%s: %s is left out: %s", group, code, why, exc_info=not is_absent)
            self.rows = []
            self.skipped = Skipped(code=code, group=group, why=why, has_failed=not is_absent)


def run_contest(
    teams: Sequence[Team], settings: Settings, *, num_parallel: int = 1
) -> tuple[list[Row], list[Skipped]]:
    """Time all cases of all teams in turn.

    Args:
        teams: one process each.
        settings: rounds and length of the bursts.
        num_parallel: teams that are prepared at the same time, as they may compile.

    Returns:
        A row per case, and the teams that could not take part.
    """
    players = [_Player(team) for team in teams]
    try:
        with ThreadPoolExecutor(num_parallel) as threads:
            list(threads.map(lambda player: player.prepare(settings), players))
        for _ in tqdm(range(settings.rounds), desc="rounds", disable=None):
            for player in players:
                player.play()
    finally:
        for player in players:
            player.process.shutdown()
    rows = [row for player in players for row in player.rows]
    return rows, [player.skipped for player in players if player.skipped]


_entries: list[Entry] = []  # of this process


def _prepare(team: Team, settings: Settings) -> list[Row]:
    torch.set_num_threads(settings.threads)
    _entries.extend(team.make(settings))
    rows = []
    for entry in _entries:
        known = {each.name: getattr(entry, each.name) for each in fields(Row)}
        if entry.num_steps is None:
            known["num_steps"] = find_length(entry, settings.burst)
        elif entry.num_steps:
            time_burst(entry, entry.num_steps)  # the first may compile
        rows.append(Row(**known | {"code": team.code, "group": team.group}))
    return rows


def _play(index: int, num_steps: int) -> tuple[float, dict[str, float]]:
    return time_burst(_entries[index], num_steps)


def time_burst(entry: Entry, num_steps: int) -> tuple[float, dict[str, float]]:
    """Return the seconds of one step, and further numbers of the burst."""
    entry.prepare()
    if entry.num_steps is None:
        entry.advance(max(1, num_steps // _WARM_UP // entry.multiple) * entry.multiple)
    start = time.perf_counter()
    extras = entry.advance(num_steps)
    return (time.perf_counter() - start) / num_steps, extras or {}


def find_length(entry: Entry, burst: float) -> int:
    """Return how many steps fill a burst of some seconds."""
    num_steps = entry.multiple
    time_burst(entry, num_steps)  # the first run may compile, or touch memory for the first time
    while True:
        spent = time_burst(entry, num_steps)[0] * num_steps
        if spent >= 0.5 * burst or num_steps >= 1_000_000:
            return max(1, round(num_steps * burst / spent / entry.multiple)) * entry.multiple
        num_steps = 2 * num_steps
