"""Learning from rollouts of the current policy, which are then discarded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import SamplerWithoutReplacement

from fishrl.training.learner import Learner, Networks
from fishrl.training.settings import LearningSettings


class OnPolicyLearner(Learner):
    """Replace the buffer by each complete rollout, and draw its transitions once per epoch.

    Args:
        networks: the loss has a critic and a value estimator with ``lmbda``, as TorchRL's PPO.
        settings: see ``Learner``; ``buffer_size`` is that of one rollout.
        rollout_length: decisions of each flow in a rollout.
        gae_lambda: lambda of generalised advantage estimation.
    """

    def __init__(
        self,
        networks: Networks,
        settings: LearningSettings,
        *,
        rollout_length: int,
        gae_lambda: float,
    ) -> None:
        networks.loss.make_value_estimator(gamma=settings.gamma, lmbda=gae_lambda)
        super().__init__(
            networks,
            settings,
            keys=("advantage", "value_target"),
            sampler=SamplerWithoutReplacement(),
        )
        self.rollout = Rollout(rollout_length, self._estimate)

    def _remember(self, transitions: TensorDictBase) -> None:
        """Take one decision of each flow, always in the same order."""
        decision = transitions.select(*self.loss.in_keys, ("next", "diverged"))
        if (whole := self.rollout.add(decision)) is not None:
            self.buffer.empty()
            self._extend(whole)

    @property
    def is_ready(self) -> bool:
        """Whether the last ``store`` completed a rollout."""
        return self.rollout.is_complete and super().is_ready

    def _estimate(self, transitions: TensorDictBase) -> None:
        """Write advantages and value targets of transitions ``[B, T]``.

        A row that diverged bootstraps from its last state, as if it had been truncated there.
        """
        loss: Any = self.loss
        loss.value_estimator(
            transitions,
            params=loss.critic_network_params,
            target_params=loss.target_critic_network_params,
        )

    def components(self) -> dict[str, Any]:
        """Add the decisions of an incomplete rollout."""
        return {"rollout": self.rollout, **super().components()}


class Rollout:
    """Consecutive decisions of each flow, whose advantages are estimated once they are complete.

    Args:
        length: decisions of each flow.
        estimate: writes the advantages of transitions ``[B, length]``, whose rows are flows.
    """

    def __init__(self, length: int, estimate: Callable[[TensorDictBase], object]) -> None:
        self._length, self._estimate = length, estimate
        self._decisions: list[TensorDictBase] = []

    @property
    def is_complete(self) -> bool:
        """Whether the last ``add`` completed it."""
        return not self._decisions

    def add(self, decision: TensorDictBase) -> TensorDictBase | None:
        """Add a decision ``[B]`` of all flows; return all ``[B * length]`` if it completes them."""
        self._decisions.append(decision.clone())  # a collector reuses its memory
        if len(self._decisions) < self._length:
            return None
        whole = torch.stack(self._decisions, 1).contiguous()
        self._decisions = []
        with torch.no_grad():
            self._estimate(whole)
        return whole.reshape(-1)

    def state_dict(self) -> dict[str, Any]:
        """Return the decisions so far."""
        return {"decisions": [decision.clone().to_dict() for decision in self._decisions]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        self._decisions = [TensorDict.from_dict(d, batch_dims=1) for d in state["decisions"]]
