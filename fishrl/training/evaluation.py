"""Evaluation of policies: one episode from each of a set of fixed starts."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from fishrl.envs.episodes import Episodes, Policy, run_episodes
from fishrl.training.callback import Callback

#: Seeds of the fixed starts that choose the best checkpoint and that end a run; training draws its
#: starts from generators far from both.
SELECTION_SEED, FINAL_SEED, TRAIN_SEED = 1, 0, 1000


def evaluate_from(
    env: EnvBase,
    policy: Policy,
    starts: TensorDictBase,
    *,
    callbacks: Callback,
    is_counted: bool = True,
) -> Episodes:
    """Run one episode from each of the ``starts`` ``[E]``; a learned policy acts greedily.

    The current episodes of the env are abandoned. ``callbacks`` receive the steps and, if
    ``is_counted``, the progress in episodes.
    """

    def follow(start_of: Tensor, step: TensorDictBase) -> None:
        callbacks.on_step(step)
        if is_counted:
            has_ended = (start_of >= 0) & step["next", "done"].squeeze(-1)
            callbacks.on_progress(int(has_ended.sum()))

    return run_episodes(env, policy, starts, on_step=follow)


def fixed_starts(task: Any, num: int, *, seed: int) -> TensorDict:
    """Draw the starts of an evaluation, the same for the same seed and number."""
    return task.sample_starts(num, torch.Generator().manual_seed(seed))
