"""The protocol: a process per code, short bursts in turn, every entry once a round.

A machine that changes its mind does so for all entries of a round, so what is compared are speeds
of the same round. Each process measures its own bursts; while one runs, the others wait. A burst
begins when the threads of the one before have gone to sleep (they look for work for some
milliseconds first), and with steps that do not count, which fill the caches and wake its own.
"""

from __future__ import annotations

import logging
import multiprocessing
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from multiprocessing.connection import Connection, wait
from typing import Any

from tqdm import tqdm

from experiments.benchmarks.entry import Entry, Settings, Team
from experiments.benchmarks.results import Row, Skipped

logger = logging.getLogger(__name__)
_PAUSE = 0.01  # seconds; a thread of GNU's OpenMP was seen to spin for four milliseconds
_WARM_UP = 4  # such a part of a burst runs before it and does not count
_BAR = "{desc} {percentage:3.0f}%|{bar:20}| {n_fmt}/{total_fmt} rounds [{elapsed}<{remaining}]"
_SENT = tuple(f.name for f in fields(Entry) if f.name not in ("advance", "prepare", "multiple"))


class _Player:
    """The process of one team."""

    def __init__(self, team: Team, burst: float) -> None:
        # spawned, not forked: a fork of a process with threads (torch has some) may hang
        context = multiprocessing.get_context("spawn")
        self.team = team
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, team, burst), daemon=True)
        self.process.start()
        theirs.close()
        self.entries: list[dict[str, Any]] = []
        self.seconds: list[list[float]] = []
        self.extras: list[dict[str, list[float]]] = []
        self.skipped: Skipped | None = None

    def receive_entries(self) -> None:
        """Take what the process has made, or why it has made nothing."""
        answer = self._receive()
        if isinstance(answer, Skipped):
            self._leave(answer)
            return
        self.entries = answer
        self.seconds = [[] for _ in answer]
        self.extras = [{} for _ in answer]

    def play(self, *, counts: bool) -> None:
        """Run a burst of each entry; a process that fails is out, with all it has measured."""
        for index in range(len(self.entries)):
            time.sleep(_PAUSE)
            with suppress(ConnectionError):  # it is gone: what it sent last says so
                self.connection.send(index)
            answer = self._receive()
            if isinstance(answer, Skipped):
                self._leave(answer)
                return
            if counts:
                self.seconds[index].append(answer[0])
                for name, value in answer[1].items():
                    self.extras[index].setdefault(name, []).append(value)

    def _receive(self) -> Any:
        try:
            return self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            why = f"its process ended with exit status {self.process.exitcode}"
            return Skipped(self.team.code, self.team.group, why, True)

    def _leave(self, skipped: Skipped) -> None:
        self.skipped, self.entries, self.seconds, self.extras = skipped, [], [], []
        self.close()

    def list_rows(self) -> list[Row]:
        """Return what was measured."""
        return [
            Row(
                code=self.team.code, group=self.team.group, seconds=tuple(seconds),
                extras=extras, **entry,
            )
            for entry, seconds, extras in zip(self.entries, self.seconds, self.extras, strict=True)
        ]  # fmt: skip

    def close(self) -> None:
        """End the process: gently, as it may have processes of its own."""
        self.connection.close()
        self.process.join(timeout=10.0)
        self.process.terminate()
        self.process.join()


def run_contest(
    teams: Sequence[Team], settings: Settings, *, name: str = "measuring"
) -> tuple[list[Row], list[Skipped]]:
    """Time all entries of all teams in turn.

    Args:
        teams: one process each.
        settings: rounds and length of the bursts.
        name: of the progress bar.

    Returns:
        A row per entry, and the teams that could not take part.
    """
    players = []
    try:
        players = _gather(teams, settings)
        bar = tqdm(
            total=settings.rounds, desc=name, bar_format=_BAR, disable=not sys.stderr.isatty()
        )
        with bar:
            for number in range(settings.rounds + 1):
                for player in players:
                    player.play(counts=number > 0)  # the first round warms up
                bar.update(number > 0)
    finally:
        for player in players:
            player.close()
    skipped = [player.skipped for player in players if player.skipped is not None]
    for each in skipped:
        logger.warning("%s: %s is left out: %s", each.group, each.code, each.why)
    return [row for player in players for row in player.list_rows()], skipped


def _gather(teams: Sequence[Team], settings: Settings) -> list[_Player]:
    """Start the processes, as many at a time as there are cores; making entries may compile."""
    players: list[_Player] = []
    busy: dict[Connection[Any, Any], _Player] = {}
    waiting = list(teams)
    try:
        while waiting or busy:
            while waiting and len(busy) < settings.threads:
                player = _Player(waiting.pop(0), settings.burst)
                players.append(player)
                busy[player.connection] = player
                logger.info("%s: preparing %s ...", player.team.group, player.team.code)
            for connection in wait(list(busy)):
                assert isinstance(connection, Connection)
                busy.pop(connection).receive_entries()
    except BaseException:
        for player in players:
            player.close()
        raise
    return players


def _serve(connection: Connection[Any, Any], team: Team, burst: float) -> None:
    """Make a team's entries and time them on demand until the other side closes the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent decides
    try:
        entries = list(team.make(**team.arguments))
        lengths = [entry.num_steps or find_length(entry, burst) for entry in entries]
    except ImportError as error:
        connection.send(Skipped(team.code, team.group, str(error), False))
        return
    except Exception as problem:  # noqa: BLE001 - whatever it is, it is this code's alone
        connection.send(_describe(team, problem))
        return
    connection.send(
        [
            {name: getattr(entry, name) for name in _SENT} | {"num_steps": length}
            for entry, length in zip(entries, lengths, strict=True)
        ]
    )
    while True:
        try:
            index = connection.recv()
        except EOFError:
            return
        try:
            connection.send(_time(entries[index], lengths[index]))
        except Exception as problem:  # noqa: BLE001 - likewise
            connection.send(_describe(team, problem))
            return


def _describe(team: Team, problem: Exception) -> Skipped:
    traceback.print_exc()
    return Skipped(team.code, team.group, f"{type(problem).__name__}: {problem}", True)


def _time(entry: Entry, num_steps: int) -> tuple[float, dict[str, float]]:
    """Return the seconds of one step, and what else the burst has to say."""
    if entry.prepare is not None:
        entry.prepare()
    if entry.num_steps is None:
        entry.advance(max(1, num_steps // _WARM_UP // entry.multiple) * entry.multiple)
    start = time.perf_counter()
    extras = entry.advance(num_steps)
    return (time.perf_counter() - start) / num_steps, extras or {}


def find_length(entry: Entry, burst: float) -> int:
    """Return how many steps fill a burst.

    Args:
        entry: is run to find out.
        burst: seconds.
    """
    num_steps = entry.multiple
    _time(entry, num_steps)  # the first run may compile, or touch memory for the first time
    while True:
        spent = _time(entry, num_steps)[0] * num_steps
        if spent >= 0.5 * burst or num_steps >= 1_000_000:
            return max(1, round(num_steps * burst / spent / entry.multiple)) * entry.multiple
        num_steps = 2 * num_steps
