"""How well a fish does: one episode from each of a set of fixed starts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

Policy = Callable[[TensorDictBase], TensorDictBase]


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Outcome of E episodes, in the order of their starts.

    Args:
        succeeded: ``[E]`` bool, whether the task was accomplished, see ``has_succeeded``.
        returns: ``[E]`` sum of rewards.
        lengths_T: ``[E]`` duration in tail beats.
        diverged: ``[E]`` bool, whether the flow diverged; such an episode counts as no
            success.
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
        env: of the task; what it does at the moment is given up.
        decision_T: duration of one decision in tail beats.
    """

    def __init__(self, env: EnvBase, *, decision_T: float = 1.0) -> None:
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
            on_episodes: called with the number of episodes that have just ended.
            on_step: called after each decision with what the env returned.

        Returns:
            The outcome of each start.
        """
        base = self.env.base_env
        base.load_state_dict(copy_state(self._initial))
        before, base.starts = base.starts, starts.to(self.env.device)
        try:
            return self._run(
                policy, num_starts=starts.shape[0], on_episodes=on_episodes, on_step=on_step
            )
        finally:
            base.starts = before
            base.is_resting = torch.zeros_like(base.is_resting)

    def _run(
        self,
        policy: Policy,
        *,
        num_starts: int,
        on_episodes: Callable[[int], None] | None,
        on_step: Callable[[TensorDictBase], None] | None,
    ) -> Evaluation:
        num_rows, name = self.env.batch_size[0], self.env.base_env.task.success
        results = TensorDict(
            {
                "succeeded": torch.zeros(num_starts, dtype=torch.bool),
                "returns": torch.zeros(num_starts),
                "lengths_T": torch.zeros(num_starts),
                "diverged": torch.zeros(num_starts, dtype=torch.bool),
            },
            [num_starts],
        )
        is_handed_out = [False] * num_starts
        # The start whose first episode runs in a row, or -1: a repetition, that does not count.
        running = [-1] * num_rows
        num_open = num_starts
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            state = self.env.reset()
            is_new = [True] * num_rows
            while num_open > 0:
                index = state["start_index"].reshape(-1).tolist()
                for row in range(num_rows):
                    if is_new[row]:
                        start = index[row]
                        running[row] = -1 if is_handed_out[start] else start
                        is_handed_out[start] = True
                self.env.base_env.is_resting = torch.tensor(
                    [start < 0 for start in running], device=self.env.device
                )
                step, state = self.env.step_and_maybe_reset(policy(state))
                if on_step is not None:
                    on_step(step)
                after = step["next"].to("cpu")
                is_new = after["done"].reshape(-1).tolist()
                ended = [row for row in range(num_rows) if is_new[row] and running[row] >= 0]
                for row in ended:
                    results[running[row]] = TensorDict(
                        {
                            "succeeded": has_succeeded(after, name)[row].any(),
                            "returns": after["episode_reward"][row].sum(),
                            "lengths_T": after["step_count"][row].sum() * self.decision_T,
                            "diverged": after["diverged"][row].any(),
                        }
                    )
                num_open -= len(ended)
                if on_episodes is not None and ended:
                    on_episodes(len(ended))
        return Evaluation(
            succeeded=results["succeeded"],
            returns=results["returns"],
            lengths_T=results["lengths_T"],
            diverged=results["diverged"],
        )


def has_succeeded(after: TensorDictBase, name: str) -> Tensor:
    """Return whether episodes that are done accomplished their task.

    Args:
        after: where they ended.
        name: of the entry that says so, ``success`` of the task; without it, those that lasted
            until the time limit did.
    """
    flag: Tensor | None = after.get(name)
    if flag is not None:
        return flag
    return after["truncated"] & ~after["terminated"] & ~after["diverged"]


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
