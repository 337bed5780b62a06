"""The progress bar of a run."""

import sys
from collections.abc import Mapping
from typing import TextIO

from tqdm import tqdm

from fishrl.training.callback import NOTHING, Callback

_LINE = "{desc} {percentage:3.0f}% {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]"
_BAR = _LINE.replace("%", "%|{bar:20}|")


class _Lines:
    """A stream in which a bar becomes lines, one for each state with something done."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        if (line := text.strip()) and "% 0/" not in line:
            self._stream.write(f"{line}\n")

    def flush(self) -> None:
        self._stream.flush()


class Progress(Callback):
    """A bar in frames with the phase at its left: set-up, compilation, warm-up, training, ...

    Args:
        stream: where the bar is drawn. Anything but a terminal gets a line at the end of a phase
            and every minute.
    """

    def __init__(self, *, stream: TextIO | None = None) -> None:
        stream = stream or sys.stderr
        self._is_terminal = stream.isatty()
        self._bar = tqdm(
            total=1,
            desc=f"{'set-up':<12}",
            file=stream if self._is_terminal else _Lines(stream),
            mininterval=0.2 if self._is_terminal else 60.0,
            miniters=1,  # else a thread of tqdm repeats the line of a slow run
            bar_format=_BAR if self._is_terminal else _LINE,
            leave=True,
        )
        self.phase = "set-up"

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bar as it is; later output appears below it."""
        self._bar.close()

    def on_phase(self, phase: str, *, total: int | None = None, done: int = 0) -> None:
        """Begin a bar, or name another phase on the same bar."""
        if phase != self.phase:
            if not self._is_terminal:
                self._bar.refresh()
            self.phase = phase
            self._bar.set_description_str(f"{phase:<12}", refresh=self._is_terminal)
        if total is not None:
            self._bar.set_postfix_str("", refresh=False)
            self._bar.initial = done  # earlier frames do not count for the speed
            self._bar.reset(total=total)
            self._bar.n = done
            self._bar.refresh()

    def on_progress(self, amount: int, shown: Mapping[str, float] = NOTHING) -> None:
        """Advance the bar and show some numbers next to it."""
        if shown:
            # a dash where there is no number yet, as before the first episode ends
            words = {name: "-" if v != v else f"{v:.3g}" for name, v in shown.items()}
            text = ", ".join(f"{name} {value}" for name, value in words.items())
            self._bar.set_postfix_str(text, refresh=False)
        # a run may end some frames later; tqdm would drop the total
        self._bar.total = max(self._bar.total, self._bar.n + amount)
        self._bar.update(amount)
        if amount and self._bar.n == self._bar.total and self._is_terminal:
            self._bar.refresh()
