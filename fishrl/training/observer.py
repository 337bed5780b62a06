"""Hooks into a training or an evaluation, such as for a live view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

if TYPE_CHECKING:
    from fishrl.training.loop import Training


class Observer:
    """Base of observers, which must not change what they observe; every method does nothing.

    A live view and the pictures at the end of a run are observers.
    """

    def begin(self, env: EnvBase) -> None:
        """Receive the env before its first step; ``env.base_env.on_frame`` may be set here."""

    def settle(self, step: TensorDictBase) -> None:
        """Receive a completed step, ``[B]`` as the env returns it."""

    def restart(self) -> None:
        """Expect new episodes: an evaluation has ended."""

    def finish(self, training: Training, summary: Mapping[str, Any]) -> None:
        """Receive a finished training and its summary, before the summary is written."""

    def close(self) -> None:
        """Release resources; no other call follows."""
