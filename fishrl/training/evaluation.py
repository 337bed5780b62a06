"""Evaluation of a policy: one episode from each of a set of fixed starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs.episodes import Episodes, Policy, run_episodes


def evaluate_from(
    env: TransformedEnv,
    policy: Policy,
    starts: TensorDictBase,
    *,
    on_episodes: Callable[[int], None] | None = None,
    on_step: Callable[[TensorDictBase], None] | None = None,
) -> Episodes:
    """Run one episode from each of the ``starts`` ``[E]``; a learned policy acts greedily.

    The current episodes of the env are abandoned. After each decision ``on_episodes`` gets the
    number of episodes that it ended, and ``on_step`` what the env returned.
    """

    def follow(start_of: Tensor, step: TensorDictBase) -> None:
        if on_step is not None:
            on_step(step)
        if on_episodes is not None:
            on_episodes(int(((start_of >= 0) & step["next", "done"].squeeze(-1)).sum()))

    return run_episodes(env, policy, starts, on_step=follow)


def fixed_starts(task: Any, num: int, *, seed: int) -> TensorDict:
    """Draw the starts of an evaluation: the same ones for the same seed and number."""
    return task.sample_starts(num, torch.Generator().manual_seed(seed))
