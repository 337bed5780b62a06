"""DRQN: DQN with an LSTM in place of the observation stack."""

from typing import Any

import torch
from pydantic import PositiveInt
from tensordict.nn import TensorDictSequential
from torchrl.data import SliceSampler
from torchrl.modules import get_primers_from_module

from fishrl.modules import RecurrentPolicy, make_recurrent_value_actor
from fishrl.objectives import RecurrentDQNLoss
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.learner import Networks, OffPolicyLearner
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings

TRAJECTORY, STEP = ("collector", "traj_ids"), "step_count"


class DRQN(DQN):
    """DQN that reads only the newest observation and keeps the past in an LSTM.

    Hausknecht & Stone 2015, trained on sequences that begin with the LSTM state at the time of
    collection, as in Kapturowski et al. 2019 (R2D2). A gradient step reads ``batch_size /
    sequence_length`` sequences: as many transitions as for the other algorithms, or fewer if
    sequences are short.

    Args:
        sequence_length: decisions in a sequence; fewer where the buffer holds fewer of an episode.
    """

    is_traced = False  # TorchRL's LSTM looks where episodes begin
    takes_several = False  # the environment carries one LSTM state per flow

    sequence_length: PositiveInt = 8

    def make_policy(
        self, spec: PolicySpec, generator: torch.Generator | None = None
    ) -> RecurrentPolicy:
        """Make the greedy policy, which carries the LSTM state by itself."""
        sizes = spec.sizes | {"num_inputs": spec.num_observed}
        return RecurrentPolicy(make_recurrent_value_actor(**sizes, generator=generator))

    def adapt(self, settings: LearningSettings) -> dict[str, Any]:
        """Check that a batch is a whole number of sequences, and that there is a hidden layer."""
        if settings.reflect:
            raise ValueError("reflect: the LSTM states of DRQN have no mirror image; reflect=false")
        if settings.batch_size % self.sequence_length:
            raise ValueError(
                f"batch_size = {settings.batch_size}: must be a multiple of "
                f"algorithm.sequence_length = {self.sequence_length}"
            )
        if not settings.hidden:
            raise ValueError("hidden = (): DRQN needs a hidden layer, the last of which recurs")
        return super().adapt(settings)

    def count_states(self, settings: LearningSettings) -> int:
        """Count the two states of the LSTM."""
        return 2 * settings.hidden[-1]

    def make_loss(
        self, policy: Any, spec: PolicySpec, generator: torch.Generator
    ) -> RecurrentDQNLoss:
        """Make the loss of sequences."""
        return RecurrentDQNLoss(
            policy.network, sequence_length=self.sequence_length, is_double=self.is_double
        )

    def make_explorer(self, policy: Any, spec: PolicySpec) -> TensorDictSequential:
        """Make the policy that collects; the environment carries its LSTM state."""
        return super().make_explorer(policy.network, spec)

    def assemble(self, networks: Networks, settings: LearningSettings) -> OffPolicyLearner:
        """Return a learner that replays sequences."""
        # Episodes lie in pieces between those of other flows, diverged decisions are missing.
        sampler = SliceSampler(
            slice_len=self.sequence_length,
            traj_key=TRAJECTORY,
            step_key=STEP,
            fragmented=True,
            strict_length=False,
            pad_output=True,
            init_key=None,
            truncated_key=None,
        )
        primer = get_primers_from_module(networks.actor)
        parts = networks._replace(transforms=(primer,), sampler=sampler, keys=(TRAJECTORY, STEP))
        return OffPolicyLearner(parts, settings)
