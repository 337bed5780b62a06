"""Discrete soft actor-critic, the algorithm of the paper."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torchrl.modules import ProbabilisticActor

from experiments.settings import ConfigError, TrainConfig
from fishrl.modules import make_actor, make_twin_critics
from fishrl.objectives import MaskedDiscreteSACLoss
from fishrl.training.algorithms.algorithm import Algorithm
from fishrl.training.checkpoint import BrainOf
from fishrl.training.learner import Learner


class DiscreteSAC(Algorithm):
    """Actor, twin critics and a temperature; see ``fishrl.objectives.MaskedDiscreteSACLoss``.

    Args:
        alpha_init: initial temperature.
        target_entropy_weight: share of the largest entropy that the policy shall keep.

    Raises:
        ConfigError: if one of them cannot be.
    """

    label = ""

    def __init__(self, *, alpha_init: float = 1.0, target_entropy_weight: float = 0.1) -> None:
        if alpha_init <= 0:
            raise ConfigError(f"algorithm.alpha_init = {alpha_init}: must be greater than 0")
        if not 0 <= target_entropy_weight <= 1:
            raise ConfigError(
                f"algorithm.target_entropy_weight = {target_entropy_weight}: must lie in [0, 1]"
            )
        self.alpha_init, self.target_entropy_weight = alpha_init, target_entropy_weight

    def make_policy(
        self,
        brain: BrainOf,
        *,
        hidden: Sequence[int],
        generator: torch.Generator | None = None,
    ) -> ProbabilisticActor:
        """Make the softmax actor."""
        return make_actor(
            num_inputs=brain.num_inputs,
            num_actions=brain.num_actions,
            hidden=hidden,
            generator=generator,
        )

    def make_learner(self, brain: BrainOf, config: TrainConfig) -> Learner:
        """Make the actor, which explores by itself, and its critics."""
        generator = torch.Generator().manual_seed(config.seed)
        actor = self.make_policy(brain, hidden=config.hidden, generator=generator).to(config.device)
        critics = make_twin_critics(
            num_inputs=brain.num_inputs,
            num_actions=brain.num_actions,
            hidden=config.hidden,
            generator=generator,
        )
        loss = MaskedDiscreteSACLoss(
            actor,
            [critic.to(config.device) for critic in critics],
            num_actions=brain.num_actions,
            alpha_init=self.alpha_init,
            target_entropy_weight=self.target_entropy_weight,
        )
        return Learner(actor=actor, explorer=actor, loss=loss, reports=loss.out_keys, config=config)
