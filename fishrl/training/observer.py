"""What may look on while policies are trained or evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from tensordict import TensorDictBase
from torchrl.envs import EnvBase

if TYPE_CHECKING:
    from fishrl.training.loop import Training


class Observer:
    """Sees what a training or an evaluation does, and must change nothing; by default, idle.

    A live view and the pictures at the end of a run are observers.
    """

    def begin(self, env: EnvBase) -> None:
        """Get the env before its first step; its ``base_env.on_frame`` may be set."""

    def settle(self, step: TensorDictBase) -> None:
        """See a decision that is over, ``[B]`` as the env returns it."""

    def restart(self) -> None:
        """Expect other episodes: an evaluation has ended."""

    def finish(self, training: Training, summary: Mapping[str, Any]) -> None:
        """Get a training whose summary is complete, before that is written."""

    def close(self) -> None:
        """Release what is held; nothing follows."""
