"""Ending a run when it is told to: Ctrl-C, SIGTERM of a scheduler, and who shall not hear them."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType

logger = logging.getLogger(__name__)

SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: Within which the same signal counts as one: a scheduler and the sweep that it ends both send it.
TWICE_SECONDS = 1.0


class Interrupted(Exception):
    """The program was told to end, and nothing is half done.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class Interruption:
    """Remembers a signal until there is a good moment to end; a second one ends at once.

    As a context it listens to the signals of the process; without that it only does as asked.
    """

    def __init__(self) -> None:
        self._number: int | None = None
        self._heard = 0.0
        self._before: dict[signal.Signals, object] = {}

    def request(self, number: int = signal.SIGTERM) -> None:
        """Ask for an end at the next ``check``."""
        self._number = number

    def check(self) -> None:
        """Call this where nothing is half done.

        Raises:
            Interrupted: if an end was asked for.
        """
        if self._number is not None:
            raise Interrupted(self._number)

    def __enter__(self) -> Interruption:
        for number in SIGNALS:
            self._before[number] = signal.signal(number, self._hear)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _hear(self, number: int, frame: FrameType | None) -> None:
        if self._number is not None:
            if number == self._number and time.monotonic() - self._heard < TWICE_SECONDS:
                return
            raise KeyboardInterrupt
        self.request(number)
        self._heard = time.monotonic()
        name = signal.Signals(number).name
        logger.warning("%s: saving at the next step; a second signal ends at once", name)


@contextmanager
def spare_children() -> Iterator[None]:
    """Start processes inside that Ctrl-C and SIGTERM for the whole group do not end.

    They end with this one, which first wants an answer from them. A signal that comes meanwhile
    is heard at the end.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
