"""The progress bar of a run."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TextIO

from tqdm import tqdm

_FORMAT = "{desc} {percentage:3.0f}%|{bar:20}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]"


class Progress:
    """A bar in frames with the phase at its left: set-up, compilation, warm-up, training, ...

    Args:
        stream: where the bar is drawn. Anything but a terminal gets a line every few seconds.
        is_shown: draw at all.
    """

    def __init__(self, *, stream: TextIO | None = None, is_shown: bool = True) -> None:
        stream = stream or sys.stderr
        self._bar = tqdm(
            total=1,
            desc=_label("set-up"),
            file=stream,
            disable=not is_shown,
            mininterval=0.2 if stream.isatty() else 10.0,
            bar_format=_FORMAT,
            leave=True,
        )
        self.phase = "set-up"

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bar as it is; later output appears below it."""
        self._bar.close()

    def start(self, phase: str, *, total: int, done: int = 0) -> None:
        """Begin a bar of ``total`` frames or episodes, ``done`` of which are already over."""
        self.rename(phase)
        self._bar.set_postfix_str("", refresh=False)
        self._bar.initial = done  # what was done before says nothing about the speed now
        self._bar.reset(total=total)
        self._bar.n = done
        self._bar.refresh()

    def rename(self, phase: str) -> None:
        """Go over to another phase on the same bar."""
        if phase != self.phase:
            self.phase = phase
            self._bar.set_description_str(_label(phase))

    def advance(self, amount: int, **shown: float) -> None:
        """Count ``amount`` more and show some numbers beside the bar."""
        if shown:
            words = [f"{name.replace('_', ' ')} {_show(value)}" for name, value in shown.items()]
            self._bar.set_postfix_str(", ".join(words), refresh=False)
        self._bar.update(amount)
        if amount and self._bar.n == self._bar.total:
            self._bar.refresh()


def _show(value: float) -> str:
    """Write a number; a dash where there is none yet, as before the first episode ends."""
    return "-" if value != value else f"{value:.3g}"


def _label(phase: str) -> str:
    return f"{phase:<12}"
