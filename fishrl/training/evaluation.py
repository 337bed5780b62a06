"""Evaluation of a policy: one episode from each of a set of fixed starts."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs.episodes import Episodes, Policy, run_episodes


class Evaluator:
    """Runs policies from fixed starts, all flows of the env together.

    Args:
        env: environment of the task; its current episodes are abandoned.
    """

    def __init__(self, env: TransformedEnv) -> None:
        self.env = env
        # Every evaluation begins with the same start in the same row.
        self._initial = deepcopy(env.base_env.state_dict())

    def run(
        self,
        policy: Policy,
        *,
        starts: TensorDictBase,
        on_episodes: Callable[[int], None] | None = None,
        on_step: Callable[[TensorDictBase], None] | None = None,
    ) -> Episodes:
        """Run one episode from each of the ``starts`` ``[E]``; a learned policy acts greedily.

        After each decision ``on_episodes`` gets the number of episodes that it ended, and
        ``on_step`` what the env returned.
        """

        def follow(start_of: Tensor, step: TensorDictBase) -> None:
            if on_step is not None:
                on_step(step)
            if on_episodes is not None:
                on_episodes(int(((start_of >= 0) & step["next", "done"].squeeze(-1)).sum()))

        self.env.base_env.load_state_dict(deepcopy(self._initial))
        return run_episodes(self.env, policy, starts, on_step=follow)


def fixed_starts(task: Any, num: int, *, seed: int) -> TensorDict:
    """Draw the starts of an evaluation: the same ones for the same seed and number."""
    return task.sample_starts(num, torch.Generator().manual_seed(seed))
