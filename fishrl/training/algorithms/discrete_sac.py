"""Discrete soft actor-critic, the algorithm of the paper."""

from typing import Annotated

import torch
from pydantic import Field
from torchrl.modules import ProbabilisticActor

from fishrl.modules import make_actor, make_twin_critics
from fishrl.objectives import MaskedDiscreteSACLoss
from fishrl.training.algorithms.algorithm import Algorithm
from fishrl.training.policy_spec import PolicySpec


class DiscreteSAC(Algorithm):
    """Actor, twin critics and a temperature; see ``fishrl.objectives.MaskedDiscreteSACLoss``.

    Args:
        alpha_init: initial temperature.
        target_entropy_weight: target entropy as a share of the largest possible one.
        norms_critics: whether critics have layer normalisation, as those of ``SAC`` do.
    """

    is_traced = True
    has_critic = True

    alpha_init: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    target_entropy_weight: Annotated[float, Field(ge=0, le=1)] = 0.1
    norms_critics: bool = False

    @property
    def label(self) -> str:
        """Nothing, as names of run folders leave out the default algorithm."""
        return "" if type(self) is DiscreteSAC else super().label

    def make_policy(
        self, spec: PolicySpec, generator: torch.Generator | None = None
    ) -> ProbabilisticActor:
        """Make the softmax actor, which also explores."""
        return make_actor(**spec.sizes, generator=generator)

    def make_loss(
        self, policy: ProbabilisticActor, spec: PolicySpec, generator: torch.Generator
    ) -> MaskedDiscreteSACLoss:
        """Make the loss with twin critics."""
        device = next(policy.parameters()).device
        critics = make_twin_critics(
            **spec.critic_sizes, is_normed=self.norms_critics, generator=generator
        )
        return MaskedDiscreteSACLoss(
            policy,
            [critic.to(device) for critic in critics],
            num_actions=spec.num_actions,
            alpha_init=self.alpha_init,
            target_entropy_weight=self.target_entropy_weight,
        )
