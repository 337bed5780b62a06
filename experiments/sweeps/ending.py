"""Ending a sweep or a search when it is told to: its runs save first, whoever launched them."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from experiments.sweeps.runs import find_writers
from fishrl.training.interruption import SIGNALS

logger = logging.getLogger(__name__)

#: Exit codes of a training that was told to end; it has said how to go on.
TOLD_CODES = tuple(128 + number for number in SIGNALS)
#: After which a run that still does not end is left to whoever launched it.
SAVE_SECONDS = 600.0
_LOOK_SECONDS = 0.1


class Terminated(KeyboardInterrupt):
    """The program was told to end, and the runs below it have ended.

    Args:
        number: of the signal.
        told: process ids of these runs.
    """

    def __init__(self, number: int, told: set[int]) -> None:
        super().__init__(signal.Signals(number).name)
        self.number, self.told = number, told


@contextmanager
def ending_runs(folder: Path) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the runs below this process first, and then what is inside.

    A launcher may kill its processes where it is interrupted, so they are waited for before.
    Ctrl-C in a terminal is heard by the runs too, another signal may be told to this process
    alone; a run that is told twice at once takes it as one, see ``Interruption``. A second signal
    is passed on, and ends them at once.

    Args:
        folder: where the run folders lie.

    Raises:
        Terminated: inside, when they have ended.
    """
    told: set[int] = set()
    is_ending = False

    def hear(number: int, frame: FrameType | None) -> None:
        nonlocal is_ending
        told.clear()  # the loop below, which this may have interrupted, tells everyone anew
        if is_ending:
            return
        is_ending = True
        name = signal.Signals(number).name
        logger.warning("%s: waiting for what runs to save; a second signal ends it at once", name)
        heard, end = set(), time.monotonic() + SAVE_SECONDS
        while (below := _find_below(folder)) and time.monotonic() < end:
            for process in below - told:
                _tell(process, number)
            told.update(below)
            heard |= below
            time.sleep(_LOOK_SECONDS)
        raise Terminated(number, heard)

    before = {number: signal.signal(number, hear) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def leave_ending_to_sweep() -> None:
    """Let no signal end a process that joblib made for the jobs of a sweep.

    joblib kills all of them, and the runs below, where one ends: the sweep has the runs save first.
    In other processes nothing is changed.
    """
    if multiprocessing.parent_process() is not None:
        for number in SIGNALS:  # no SIG_IGN, which the runs would inherit
            signal.signal(number, lambda number, frame: None)


def _tell(process: int, number: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, number)


def _find_below(folder: Path) -> set[int]:
    """Return the processes that write a run in a folder and descend from this one."""
    return {process for process in find_writers(folder) if _descends(process, os.getpid())}


def _descends(process: int, ancestor: int) -> bool:
    try:
        while process > 1 and process != ancestor:
            status = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
            process = int(status.rpartition(")")[2].split()[1])  # behind name and state: the parent
    except OSError:  # it has ended
        return False
    return process == ancestor
