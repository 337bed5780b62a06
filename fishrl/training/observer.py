"""Hooks into a training or an evaluation, such as for a live view."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypedDict

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from fishrl.training.progress import Progress

if TYPE_CHECKING:
    from fishrl.training.loop import Training


class Observer:
    """Base of observers, such as live views, which must not change what they observe."""

    def begin(self, env: EnvBase) -> None:
        """Receive the env before its first step; ``env.base_env.on_frame`` may be set here."""

    def settle(self, step: TensorDictBase) -> None:
        """Receive a completed step, ``[B]`` as the env returns it."""

    def restart(self) -> None:
        """Expect new episodes: an evaluation has ended."""

    def finish(self, training: Training, summary: Mapping[str, Any]) -> None:
        """Receive a finished training and its summary, before the summary is written."""

    def close(self) -> None:
        """Release resources; only ``begin`` may follow, where a run goes on after an error."""


class Hooks(TypedDict, total=False):
    """What a caller may add to a run.

    Args:
        make_env: makes the env of a task; by default ``fishrl.envs.make_env``.
        observer: called during the run.
        progress: progress bar; by default none is shown.
        began: ``time.perf_counter()`` when the program started.
    """

    make_env: Callable[..., EnvBase] | None
    observer: Observer | None
    progress: Progress | None
    began: float | None
