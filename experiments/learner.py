"""The learning fish: its brain, what it remembers, and one gradient step."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.objectives import SoftUpdate

from experiments.settings import TrainConfig
from fishrl.modules import make_actor, make_twin_critics
from fishrl.objectives import MaskedDiscreteSACLoss

#: What a gradient step reports, as ``train/<name>``.
LOSS_METRICS = (
    "loss_actor",
    "loss_qvalue",
    "loss_alpha",
    "alpha",
    "entropy",
    "entropy_fraction",
)


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one CPU thread: for networks this small, more threads mostly wait."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class Learner:
    """Discrete SAC with a replay buffer.

    Args:
        num_inputs: length of the stacked observation.
        num_actions: number of actions.
        config: hyper-parameters.
    """

    def __init__(self, *, num_inputs: int, num_actions: int, config: TrainConfig) -> None:
        generator = torch.Generator().manual_seed(config.seed)
        sizes: dict[str, Any] = {
            "num_inputs": num_inputs,
            "num_actions": num_actions,
            "hidden": config.hidden,
            "generator": generator,
        }
        self.actor = make_actor(**sizes).to(config.device)
        self.loss = MaskedDiscreteSACLoss(
            self.actor,
            [critic.to(config.device) for critic in make_twin_critics(**sizes)],
            num_actions=num_actions,
            alpha_init=config.alpha_init,
            target_entropy_weight=config.target_entropy_weight,
        )
        self.loss.make_value_estimator(gamma=config.gamma)
        self.targets = SoftUpdate(self.loss, tau=config.tau)
        self.optimiser = torch.optim.Adam(
            self.loss.parameters(), lr=config.learning_rate, fused=True
        )
        # No prefetch: its threads would draw batches in an order that no seed fixes.
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size, device=config.device),
            batch_size=config.batch_size,
            prefetch=0,
        )

    def remember(self, transitions: TensorDictBase) -> int:
        """Store transitions ``[N]`` but for those whose flow diverged, and return how many did.

        Raises:
            ValueError: if a state leaves no legal action.
        """
        if not transitions["next", "action_mask"].any(-1).all():
            raise ValueError(
                "action_mask: a state has no legal action; every state needs one, also a final one"
            )
        is_sound = ~transitions["next", "diverged"].reshape(-1)
        sound = transitions.select(*self.loss.in_keys)[is_sound]
        if sound.shape[0] > 0:
            self.buffer.extend(sound)
        return transitions.shape[0] - sound.shape[0]

    def update(self) -> TensorDict:
        """Take one gradient step on actor, critics and temperature, and return the losses."""
        losses = self.loss(self.buffer.sample())
        self.optimiser.zero_grad()
        (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
        self.optimiser.step()
        self.targets.step()
        return losses.detach()

    def components(self) -> dict[str, Any]:
        """Name what a checkpoint must hold of the learner."""
        return {
            "actor": self.actor,
            "loss": self.loss,
            "optimiser": self.optimiser,
            "buffer": self.buffer,
        }
