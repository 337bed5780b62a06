"""Ending a run with everything saved: on Ctrl-C, a closed terminal or a scheduler's signal."""

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

logger = logging.getLogger(__name__)

#: Sent by a terminal, or by a scheduler before a time limit; Windows lacks some.
_NAMES = ("SIGINT", "SIGHUP", "SIGTERM", "SIGUSR1", "SIGUSR2")
SIGNALS = tuple(signal.Signals[name] for name in _NAMES if hasattr(signal, name))
#: Within which the same signal counts as one: a scheduler and the sweep that it ends both send it.
TWICE_SECONDS = 1.0


class Interrupted(Exception):
    """The signal of a number was received; raised between steps, where the run can be saved."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def list_heeded() -> list[signal.Signals]:
    """Return the ``SIGNALS`` that this process does not ignore, as it may with ``nohup``."""
    return [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]


def exit_status(end: KeyboardInterrupt) -> int:
    """Return the exit status of a process that a signal ended at once: 130, or 143 for SIGTERM."""
    return 128 + (int(end.args[0]) if end.args else signal.SIGINT)


def leave_closed_terminal() -> None:
    """Discard later output if the terminal is closed, where printing would raise an error."""
    for stream in (1, 2):
        try:
            os.write(stream, b"")
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)


@contextmanager
def handling_signals(handle: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle ``SIGNALS`` in the main thread; an ignored one, as with ``nohup``, stays so."""
    is_main = threading.current_thread() is threading.main_thread()
    before = {n: signal.signal(n, handle) for n in (list_heeded() if is_main else ())}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Interruption:
    """Remembers a signal until the next ``check``; a second one ends at once."""

    def __init__(self) -> None:
        self._number: int | None = None
        self._received = 0.0

    def request(self, number: int = signal.SIGTERM) -> None:
        """Request an end at the next ``check``."""
        self._number = number

    def check(self) -> None:
        """Raise ``Interrupted`` if an end was requested; call it where the run can be saved."""
        if self._number is not None:
            raise Interrupted(self._number)

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Remember a signal that was received, see ``handling_signals``."""
        leave_closed_terminal()
        if self._number is not None:
            if number == self._number and time.monotonic() - self._received < TWICE_SECONDS:
                return
            raise KeyboardInterrupt(number)
        self.request(number)
        self._received = time.monotonic()
        name = signal.Signals(number).name
        logger.warning("%s: saving at the next step; a second signal ends at once", name)


@contextmanager
def ignore_signals_in_children() -> Iterator[None]:
    """Block ``SIGNALS`` in processes that are started inside.

    A terminal sends Ctrl-C to the whole process group; flow workers must outlive it until this
    process has saved their flows. A signal that arrives meanwhile is handled at the end.
    """
    if not hasattr(signal, "pthread_sigmask"):  # on Windows, where none are started
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
