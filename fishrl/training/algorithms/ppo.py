"""Proximal policy optimisation, for discrete and continuous actions."""

from typing import Annotated, Any

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

from fishrl.modules import make_actor, make_continuous_actor, make_state_critic
from fishrl.training.algorithms.algorithm import Algorithm
from fishrl.training.learner import Networks, OnPolicyLearner
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings


class PPO(Algorithm):
    """Actor and critic, trained on each rollout of the current policy, which is then discarded.

    Schulman et al. 2017, "Proximal Policy Optimization Algorithms", with generalised advantage
    estimation (Schulman et al. 2016), as TorchRL's ``ClipPPOLoss`` and ``GAE`` implement them;
    advantages are normalised over each batch. It explores by its own policy from the first frame:
    ``warmup_frames`` is 0, ``updates_per_frame`` and ``buffer_size`` follow from the settings here,
    and there are no target networks for ``tau``.

    Args:
        rollout_length: decisions of each flow between updates.
        num_epochs: passes over each rollout.
        clip: range within which the ratio of action probabilities is clipped, 1 +- clip.
        gae_lambda: lambda of generalised advantage estimation.
        entropy_weight: weight of the entropy bonus.
        value_weight: weight of the critic loss.
    """

    takes_continuous = True
    has_critic = True

    rollout_length: PositiveInt = 32
    num_epochs: PositiveInt = 10
    clip: Annotated[float, Field(gt=0, le=1)] = 0.2
    gae_lambda: Annotated[float, Field(ge=0, le=1)] = 0.95
    entropy_weight: NonNegativeFloat = 0.01
    value_weight: PositiveFloat = 0.5

    def adapt(self, settings: LearningSettings) -> dict[str, Any]:
        """Return the settings that give ``num_epochs`` over each rollout."""
        if settings.reflect:
            raise ValueError("reflect: PPO learns from its own decisions alone; reflect=false")
        num_frames = settings.flows.num_envs * self.rollout_length
        if num_frames % settings.batch_size:
            raise ValueError(
                f"batch_size = {settings.batch_size}: must divide flows.num_envs * "
                f"algorithm.rollout_length = {num_frames}"
            )
        updates_per_frame = self.num_epochs / settings.batch_size
        return {
            "warmup_frames": 0,
            "updates_per_frame": updates_per_frame,
            "buffer_size": num_frames,
        }

    def make_policy(
        self, spec: PolicySpec, generator: torch.Generator | None = None
    ) -> ProbabilisticActor:
        """Make the actor, which also explores."""
        make = make_continuous_actor if spec.is_continuous else make_actor
        return make(**spec.sizes, return_log_prob=True, generator=generator)

    def make_loss(
        self, policy: ProbabilisticActor, spec: PolicySpec, generator: torch.Generator
    ) -> ClipPPOLoss:
        """Make the loss with a critic of states."""
        sizes = {name: spec.critic_sizes[name] for name in ("num_inputs", "hidden", "keys")}
        critic = make_state_critic(**sizes, generator=generator)
        return ClipPPOLoss(
            policy,
            critic.to(next(policy.parameters()).device),
            clip_epsilon=self.clip,
            entropy_coeff=self.entropy_weight,
            critic_coeff=self.value_weight,
            normalize_advantage=True,
        )

    def assemble(self, networks: Networks, settings: LearningSettings) -> OnPolicyLearner:
        """Return a learner of rollouts."""
        return OnPolicyLearner(
            networks, settings, rollout_length=self.rollout_length, gae_lambda=self.gae_lambda
        )
