"""Hooks into a training or an evaluation, such as for a live view."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from fishrl.envs import make_env
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


@dataclass(frozen=True, kw_only=True)
class Hooks:
    """What a caller may add to a run.

    Args:
        make_env: makes the env of a task.
        observer: called during the run.
        progress: progress bar; by default none is shown.
        began: ``time.perf_counter()`` when the program started.
    """

    make_env: Callable[..., EnvBase] = make_env
    observer: Observer = field(default_factory=Observer)
    progress: Progress = field(default_factory=lambda: Progress(is_shown=False))
    began: float = field(default_factory=time.perf_counter)
