"""Ending a sweep: its runs save first, whichever launcher started them."""

import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

import psutil

from fishrl.training.interruption import handling_signals, leave_closed_terminal, list_heeded

logger = logging.getLogger(__name__)

#: After which a run that has not ended is left alone.
SAVE_SECONDS = 600.0


@contextmanager
def ending_runs() -> Iterator[None]:
    """On one of ``SIGNALS``, end the trainings below this process, then raise KeyboardInterrupt.

    A launcher may kill its processes where it is interrupted, so the trainings save before. Ctrl-C
    in a terminal reaches them too, another signal may reach this process alone; a training takes
    two signals at once as one. A second signal is passed on, and ends them at once.
    """
    signalled: set[int] = set()
    is_ending = False

    def pass_on(number: int, frame: FrameType | None) -> None:
        nonlocal is_ending
        leave_closed_terminal()
        signalled.clear()  # the loop below, which this may have interrupted, signals all again
        if is_ending:
            return
        is_ending = True
        name = signal.Signals(number).name
        logger.warning("%s: waiting for the runs to save; a second one ends them at once", name)
        end = time.monotonic() + SAVE_SECONDS
        while (running := find_trainings()) and time.monotonic() < end:
            for process in running - signalled:
                with suppress(ProcessLookupError):
                    os.kill(process, number)
            signalled.update(running)
            time.sleep(0.1)
        raise KeyboardInterrupt

    with handling_signals(pass_on):
        yield


def leave_ending_to_sweep() -> None:
    """Ignore signals in a process of joblib, which kills the others and their runs if one ends."""
    if multiprocessing.parent_process() is not None:
        for number in list_heeded():  # no SIG_IGN, which the runs would inherit
            signal.signal(number, lambda number, frame: None)


def find_trainings() -> set[int]:
    """Return the trainings that descend from this process."""
    trainings = set()
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):  # it has ended
            words = process.cmdline()
            if {"fishrl", "train"} <= set(words):
                trainings.add(process.pid)
    return trainings
