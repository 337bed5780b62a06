"""DQN and double DQN with action masks."""

from typing import Annotated, Any

import torch
from pydantic import Field, PositiveInt
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.data import Categorical

from fishrl.modules import EpsilonGreedy, make_value_actor
from fishrl.objectives import MaskedDQNLoss
from fishrl.training.algorithms.algorithm import Algorithm
from fishrl.training.policy_spec import PolicySpec


class DQN(Algorithm):
    """Network of action values; the policy takes the legal action with the largest value.

    Mnih et al. 2015; with ``is_double`` van Hasselt et al. 2016. Unlike there, the target network
    is updated softly, as for SAC.

    Args:
        is_double: select the next action by the online network and evaluate it by the target one.
        epsilon_start: share of random legal actions at the end of the warm-up.
        epsilon_end: final share of random legal actions.
        epsilon_frames: env frames after the warm-up over which the share falls.
    """

    is_traced = True

    is_double: bool = False
    epsilon_start: Annotated[float, Field(ge=0, le=1)] = 1.0
    epsilon_end: Annotated[float, Field(ge=0, le=1)] = 0.05
    epsilon_frames: PositiveInt = 1000

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.epsilon_end > self.epsilon_start:
            raise ValueError(
                f"epsilon_end = {self.epsilon_end}: must be at most epsilon_start = "
                f"{self.epsilon_start}"
            )

    @property
    def label(self) -> str:
        """Part of a run folder's name."""
        return "double_" * self.is_double + super().label

    def make_policy(
        self, spec: PolicySpec, generator: torch.Generator | None = None
    ) -> TensorDictModuleBase:
        """Make the greedy policy."""
        return make_value_actor(**spec.sizes, generator=generator)

    def make_loss(self, policy: Any, spec: PolicySpec, generator: torch.Generator) -> MaskedDQNLoss:
        """Make the loss, which needs no further network."""
        return MaskedDQNLoss(policy, is_double=self.is_double)

    def make_explorer(self, policy: Any, spec: PolicySpec) -> TensorDictSequential:
        """Make the policy that collects, epsilon-greedy over the legal actions."""
        device = next(policy.parameters()).device
        mixed_in = EpsilonGreedy(
            Categorical(spec.num_actions, device=device),
            eps_init=self.epsilon_start,
            eps_end=self.epsilon_end,
            annealing_num_steps=self.epsilon_frames * spec.num_fish,  # decisions of each
            action_mask_key="action_mask",
            device=device,
        )
        return TensorDictSequential(policy, mixed_in)
