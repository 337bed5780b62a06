"""Evaluation of policies: one episode from each of a set of fixed starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from fishrl.envs.episodes import Episodes, Policy, run_episodes
from fishrl.training.baselines import make_baseline
from fishrl.training.callback import Callback
from fishrl.training.interruption import Interruption
from fishrl.training.resolve import ResolvedRun

#: Training draws its starts from generators far from those of the fixed starts, which choose the
#: best checkpoint and end a run.
TRAIN_SEED, SELECTION_SEED, FINAL_SEED = 1000, 1, 0


class Evaluator:
    """Evaluate policies in the flows of a training, and leave these as they were.

    Args:
        resolved: the run.
        collector: lends its flows.
        callbacks: see ``Callback``.
        interruption: ends an evaluation early by raising ``Interrupted``.
    """

    def __init__(
        self,
        resolved: ResolvedRun,
        collector: Any,
        *,
        callbacks: Callback,
        interruption: Interruption,
    ) -> None:
        self._task, self._plan, self._baselines = resolved.task, resolved.plan, resolved.baselines
        self._collector, self._callbacks = collector, callbacks
        self._interruption = interruption

    def evaluate(
        self,
        policy: Policy,
        *,
        num_starts: int,
        seed: int,
        on_episodes: Callable[[int], None] | None = None,
    ) -> Episodes:
        """Run one episode from each of ``num_starts`` fixed starts; a learned policy is greedy."""
        starts = fixed_starts(self._task, num_starts, seed=seed)
        try:
            with self._collector.lend_env():
                return run_episodes(
                    self._collector.env,
                    self.make_interruptible(policy),
                    starts,
                    on_episodes=on_episodes,
                    on_step=lambda start_of, step: self._callbacks.on_step(step),
                )
        finally:
            self._callbacks.on_new_episodes()

    def compare(self, actor: Policy) -> dict[str, float]:
        """Return the final metrics of a learned policy, and ``<name>_...`` of each baseline."""
        num_starts, names = self._plan.run.final_episodes, self._baselines
        self._callbacks.on_phase("evaluation", total=num_starts * (1 + len(names)))
        metrics: dict[str, float] = {}
        for name in ("", *names):
            self._callbacks.on_phase(f"evaluation: {name or 'learned'}")
            result = self.evaluate(
                make_baseline(name, task=self._task, seed=FINAL_SEED) if name else actor,
                num_starts=num_starts,
                seed=FINAL_SEED,
                on_episodes=self._callbacks.on_progress,
            )
            prefix = f"{name}_" if name else ""
            metrics |= {f"{prefix}{key}": value for key, value in result.metrics().items()}
        return metrics

    def make_interruptible(self, policy: Policy) -> Policy:
        """Return a policy that raises ``Interrupted`` after a signal.

        It acts on the device of the learner, even if the flows are elsewhere.
        """

        def act(state: TensorDictBase) -> TensorDictBase:
            self._interruption.check()
            return state.update(policy(state.to(self._plan.run.policy_device)))

        return act


def fixed_starts(task: Any, num: int, *, seed: int) -> TensorDict:
    """Draw the starts of an evaluation, the same for the same seed and number."""
    return task.sample_starts(num, torch.Generator().manual_seed(seed))
