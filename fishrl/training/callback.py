"""Callbacks of a training or an evaluation, such as progress bars and live views."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from fishrl.envs.episodes import Policy

NOTHING: Mapping[str, float] = {}


class Callback:
    """Base of callbacks: each method does nothing. They must not change what they observe."""

    def on_begin(self, env: EnvBase) -> None:
        """Receive the env before a run begins; ``env.base_env.on_frame`` may be set here."""

    def on_phase(self, phase: str, *, total: int | None = None, done: int = 0) -> None:
        """Receive the name of the phase that begins.

        With ``total``, progress restarts: ``done`` of ``total`` frames or episodes are over.
        Without, the current count continues.
        """

    def on_progress(self, amount: int, shown: Mapping[str, float] = NOTHING) -> None:
        """Receive how many more frames or episodes are over, and numbers to show with them."""

    def on_step(self, step: TensorDictBase) -> None:
        """Receive a completed step ``[B]`` as the env returns it."""

    def on_new_episodes(self) -> None:
        """Expect new episodes in all flows: an evaluation has ended."""

    def on_end(
        self, summary: Mapping[str, Any], *, folder: Path, env: EnvBase, policy: Policy
    ) -> None:
        """Receive the result of a training; a run that is cut off here repeats this alone.

        Args:
            summary: content of ``summary.json``.
            folder: run folder.
            env: its flows, whose episodes may be abandoned.
            policy: the best learned policy; it raises ``Interrupted`` after a signal.
        """

    def on_close(self) -> None:
        """Release resources; only ``on_begin`` may follow, when a run continues after an error."""


#: Does nothing.
SILENT = Callback()


def join(callbacks: Iterable[Callback]) -> Callback:
    """Return several callbacks as one, which calls them in their order."""
    joined, parts = Callback(), tuple(callbacks)
    for name in vars(Callback):
        if name.startswith("on_"):
            setattr(joined, name, partial(_call, [getattr(part, name) for part in parts]))
    return joined


def _call(methods: list[Callable[..., None]], *arguments: Any, **named: Any) -> None:
    for method in methods:
        method(*arguments, **named)
