"""Value-based algorithms to compare with: DQN, double DQN, and DQN with a memory (DRQN)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.data import SliceSampler

from experiments.settings import ConfigError, TrainConfig
from fishrl.modules import (
    EpsilonGreedy,
    RecurrentPolicy,
    make_recurrent_value_actor,
    make_value_actor,
)
from fishrl.objectives import MaskedDQNLoss, RecurrentDQNLoss
from fishrl.training.algorithms.algorithm import Algorithm
from fishrl.training.checkpoint import BrainOf
from fishrl.training.learner import Learner

TRAJECTORY, STEP = ("collector", "traj_ids"), "step_count"


class DQN(Algorithm):
    """One network of action values, of which the greatest legal one is taken, or a random one.

    Mnih et al. 2015; with ``is_double`` van Hasselt et al. 2016. The target network follows the
    other softly, as those of SAC do.

    Args:
        is_double: let the network that learns choose the action whose value the target gives.
        epsilon_start: share of random legal actions when the warm-up is over.
        epsilon_end: share that remains.
        epsilon_frames: env frames after the warm-up from the one to the other.

    Raises:
        ConfigError: if one of them cannot be.
    """

    def __init__(
        self,
        *,
        is_double: bool = False,
        epsilon_start: float = 1.0,
        epsilon_end: float = 0.05,
        epsilon_frames: int = 1000,
    ) -> None:
        if not 0 <= epsilon_end <= epsilon_start <= 1:
            raise ConfigError(
                f"algorithm.epsilon_start, epsilon_end = {epsilon_start}, {epsilon_end}: the end "
                "must lie between 0 and the start, and that be at most 1"
            )
        if epsilon_frames < 1:
            raise ConfigError(f"algorithm.epsilon_frames = {epsilon_frames}: must be at least 1")
        self.is_double = is_double
        self.epsilon = (float(epsilon_start), float(epsilon_end), epsilon_frames)

    @property
    def label(self) -> str:  # type: ignore[override]
        """Part of a run folder's name."""
        return "double_dqn" if self.is_double else "dqn"

    def make_policy(
        self,
        brain: BrainOf,
        *,
        hidden: Sequence[int],
        generator: torch.Generator | None = None,
    ) -> TensorDictModuleBase:
        """Make the greedy policy."""
        return make_value_actor(
            num_inputs=brain.num_inputs,
            num_actions=brain.num_actions,
            hidden=hidden,
            generator=generator,
        )

    def make_learner(self, brain: BrainOf, config: TrainConfig) -> Learner:
        """Make the network, and an explorer that takes random legal actions now and then."""
        generator = torch.Generator().manual_seed(config.seed)
        actor = self.make_policy(brain, hidden=config.hidden, generator=generator).to(config.device)
        loss = MaskedDQNLoss(actor, is_double=self.is_double)
        return Learner(
            actor=actor,
            explorer=self._let_explore(actor, brain, config),
            loss=loss,
            reports=loss.out_keys,
            config=config,
        )

    def _let_explore(
        self, actor: TensorDictModuleBase, brain: BrainOf, config: TrainConfig
    ) -> TensorDictSequential:
        start, end, frames = self.epsilon
        chance = EpsilonGreedy(
            num_actions=brain.num_actions,
            start=start,
            end=end,
            num_frames=frames,
            device=config.device,
        )
        return TensorDictSequential(actor, chance)


class DRQN(DQN):
    """DQN that sees the newest observation alone and remembers the others in an LSTM.

    Hausknecht & Stone 2015, fed with stretches of episodes that begin with the state the LSTM was
    in when they were collected, as in Kapturowski et al. 2019 (R2D2). A gradient step reads
    ``batch_size / sequence_length`` stretches: as many transitions as that of the other algorithms,
    or fewer where stretches are short.

    Args:
        sequence_length: decisions in a stretch; what is left of a shorter episode is one, too.
        is_double: see ``DQN``.
        epsilon_start: see ``DQN``.
        epsilon_end: see ``DQN``.
        epsilon_frames: see ``DQN``.

    Raises:
        ConfigError: if one of them cannot be.
    """

    def __init__(
        self,
        *,
        sequence_length: int = 8,
        is_double: bool = False,
        epsilon_start: float = 1.0,
        epsilon_end: float = 0.05,
        epsilon_frames: int = 1000,
    ) -> None:
        super().__init__(
            is_double=is_double,
            epsilon_start=epsilon_start,
            epsilon_end=epsilon_end,
            epsilon_frames=epsilon_frames,
        )
        if sequence_length < 1:
            raise ConfigError(f"algorithm.sequence_length = {sequence_length}: must be at least 1")
        self.sequence_length = sequence_length

    @property
    def label(self) -> str:  # type: ignore[override]
        """Part of a run folder's name."""
        return "double_drqn" if self.is_double else "drqn"

    def make_policy(
        self,
        brain: BrainOf,
        *,
        hidden: Sequence[int],
        generator: torch.Generator | None = None,
    ) -> RecurrentPolicy:
        """Make the greedy policy, which remembers by itself."""
        return RecurrentPolicy(
            make_recurrent_value_actor(
                num_inputs=brain.num_observed,
                num_actions=brain.num_actions,
                hidden=hidden,
                generator=generator,
            )
        )

    def make_learner(self, brain: BrainOf, config: TrainConfig) -> Learner:
        """Make the network; while it collects, the environment carries its memory."""
        if config.batch_size % self.sequence_length:
            raise ConfigError(
                f"batch_size = {config.batch_size}: must be a multiple of "
                f"algorithm.sequence_length = {self.sequence_length}"
            )
        generator = torch.Generator().manual_seed(config.seed)
        actor = self.make_policy(brain, hidden=config.hidden, generator=generator).to(config.device)
        loss = RecurrentDQNLoss(
            actor.network, sequence_length=self.sequence_length, is_double=self.is_double
        )
        return Learner(
            actor=actor,
            explorer=self._let_explore(actor.network, brain, config),
            loss=loss,
            reports=loss.out_keys,
            config=config,
            keys=(TRAJECTORY, STEP),
            # Episodes lie in pieces between those of other flows, diverged decisions are missing.
            sampler=SliceSampler(
                slice_len=self.sequence_length,
                traj_key=TRAJECTORY,
                step_key=STEP,
                fragmented=True,
                strict_length=False,
                pad_output=True,
                init_key=None,
                truncated_key=None,
            ),
            transforms=[actor.make_primer()],
        )
