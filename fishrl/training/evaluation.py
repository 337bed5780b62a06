"""Evaluation of policies: one episode from each of a set of fixed starts."""

from typing import Any

import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from fishrl.envs.episodes import Episodes, Policy, run_episodes
from fishrl.training.callback import Callback

#: Seeds of the starts that choose the best checkpoint and that end a run; training draws its starts
#: from generators far from both.
SELECTION_SEED, FINAL_SEED, TRAIN_SEED = 1, 0, 1000


def evaluate_in(
    env: TransformedEnv,
    policy: Policy,
    num_starts: int,
    *,
    seed: int,
    callbacks: Callback,
    is_counted: bool = True,
) -> Episodes:
    """Run one episode from each of ``num_starts`` fixed starts; a learned policy acts greedily.

    The current episodes of the env are abandoned. ``callbacks`` receive the steps and, if
    ``is_counted``, the progress in episodes.
    """
    return run_episodes(
        env,
        policy,
        fixed_starts(env.base_env.task, num_starts, seed=seed),
        on_step=lambda start_of, step: callbacks.on_step(step),
        on_episodes=callbacks.on_progress if is_counted else None,
    )


def fixed_starts(task: Any, num: int, *, seed: int) -> TensorDict:
    """Draw the starts of an evaluation, the same for the same seed and number."""
    return task.sample_starts(num, torch.Generator().manual_seed(seed))
