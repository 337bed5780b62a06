"""Soft actor-critic for continuous actions."""

from typing import Annotated

import torch
from pydantic import Field
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import SACLoss

from fishrl.modules import make_continuous_actor, make_twin_critics
from fishrl.training.algorithms.algorithm import Algorithm
from fishrl.training.policy_spec import PolicySpec


class SAC(Algorithm):
    """Actor, twin critics and a temperature, for continuous actions.

    Haarnoja et al. 2018, "Soft Actor-Critic Algorithms and Applications" (arXiv 1812.05905), as
    TorchRL's ``SACLoss`` implements it.

    Args:
        alpha_init: initial temperature.
        target_entropy: target entropy per component of an action, in nats; log(2) = 0.69 is that
            of a uniform one.
    """

    takes_discrete = False
    takes_continuous = True
    is_traced = True
    has_critic = True

    alpha_init: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    target_entropy: Annotated[float, Field(le=0.69)] = -1.0

    def make_policy(
        self, spec: PolicySpec, generator: torch.Generator | None = None
    ) -> ProbabilisticActor:
        """Make the actor, which also explores."""
        return make_continuous_actor(**spec.sizes, generator=generator)

    def make_loss(
        self, policy: ProbabilisticActor, spec: PolicySpec, generator: torch.Generator
    ) -> SACLoss:
        """Make the loss with twin critics.

        Layer normalisation bounds the values of actions outside the data, which otherwise diverge
        with several gradient steps per transition (Ball et al. 2023, arXiv 2302.02948).
        """
        device = next(policy.parameters()).device
        critics = make_twin_critics(
            **spec.critic_sizes, reads_action=True, is_normed=True, generator=generator
        )
        return SACLoss(
            policy,
            [critic.to(device) for critic in critics],  # a single one would be drawn again
            alpha_init=self.alpha_init,
            target_entropy=self.target_entropy * spec.num_actions,
            deactivate_vmap=True,  # two small critics are faster one after the other
        )
