"""Evaluation of a policy: one episode from each of a set of fixed starts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs.episodes import Policy, run_episodes


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Outcome of E episodes, in the order of their starts.

    Args:
        succeeded: ``[E]`` bool, whether the task was accomplished, see ``has_succeeded``.
        returns: ``[E]`` sum of rewards.
        lengths_T: ``[E]`` duration in tail beats.
        diverged: ``[E]`` bool, whether the flow diverged; such an episode is no success.
    """

    succeeded: Tensor
    returns: Tensor
    lengths_T: Tensor
    diverged: Tensor

    def metrics(self) -> dict[str, float]:
        """Reduce to numbers; the time to success is NaN where there was none."""
        times = self.lengths_T[self.succeeded]
        return {
            "success_rate": float(self.succeeded.double().mean()),
            "mean_return": float(self.returns.double().mean()),
            "mean_length_T": float(self.lengths_T.double().mean()),
            "mean_time_to_success_T": float(times.double().mean()) if len(times) else math.nan,
            "episodes": len(self.succeeded),
            "diverged": int(self.diverged.sum()),
        }


class Evaluator:
    """Runs policies from fixed starts, all flows of the env together.

    Args:
        env: of the task; its current episodes are abandoned.
        decision_T: duration of one decision in tail beats.
    """

    def __init__(self, env: TransformedEnv, *, decision_T: float = 1.0) -> None:
        self.env, self.decision_T = env, decision_T
        # Every evaluation begins with the same start in the same row.
        self._initial = copy_state(env.base_env.state_dict())

    def run(
        self,
        policy: Policy,
        *,
        starts: TensorDictBase,
        on_episodes: Callable[[int], None] | None = None,
        on_step: Callable[[TensorDictBase], None] | None = None,
    ) -> Evaluation:
        """Run until the first episode from every start is over.

        Args:
            policy: writes ``action``; a learned one acts greedily.
            starts: ``[E]``, as ``fixed_starts`` gives.
            on_episodes: called after each decision with the number of episodes that it ended.
            on_step: called after each decision with what the env returned.
        """

        def follow(start_of: Tensor, step: TensorDictBase) -> None:
            if on_step is not None:
                on_step(step)
            if on_episodes is not None:
                on_episodes(int(((start_of >= 0) & step["next", "done"].squeeze(-1)).sum()))

        self.env.base_env.load_state_dict(copy_state(self._initial))
        episodes = run_episodes(self.env, policy, starts, on_step=follow)
        return Evaluation(
            succeeded=episodes.succeeded,
            returns=episodes.returns,
            lengths_T=episodes.lengths * self.decision_T,
            diverged=episodes.diverged,
        )


def fixed_starts(task: Any, num: int, *, seed: int) -> TensorDict:
    """Draw the starts of an evaluation: the same ones for the same seed and number."""
    return task.sample_starts(num, torch.Generator().manual_seed(seed))


def copy_state(state: Any) -> Any:
    """Copy a nested state dict, tensors and all."""
    if isinstance(state, Tensor):
        return state.clone()
    if isinstance(state, dict):
        return type(state)((key, copy_state(value)) for key, value in state.items())
    return state
