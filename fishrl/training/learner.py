"""A brain that learns: what acts, what it remembers, and one gradient step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.envs import Transform
from torchrl.objectives import LossModule, SoftUpdate

from experiments.settings import TrainConfig


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
    """What every algorithm has: a replay buffer, a loss with target networks, an optimiser.

    Args:
        actor: the policy that is evaluated and saved; under ``ExplorationType.DETERMINISTIC`` it
            acts greedily.
        explorer: the policy that collects, of the same weights; its state is the collector's.
        loss: entries ``loss_...`` of what it returns add up to what is minimised.
        reports: what a gradient step reports, as ``train/<name>``; entries of the same.
        config: settings that all algorithms share.
        keys: entries of a transition beside the loss's own that the sampler reads.
        sampler: draws from the buffer; by default uniformly.
        transforms: of the environment that collects.
    """

    def __init__(
        self,
        *,
        actor: TensorDictModuleBase,
        explorer: TensorDictModuleBase,
        loss: LossModule,
        reports: Sequence[str],
        config: TrainConfig,
        keys: Sequence[Any] = (),
        sampler: Sampler | None = None,
        transforms: Sequence[Transform] = (),
    ) -> None:
        self.actor, self.explorer, self.loss = actor, explorer, loss
        self.reports, self.transforms = tuple(reports), tuple(transforms)
        self.loss.make_value_estimator(gamma=config.gamma)
        self.targets = SoftUpdate(self.loss, tau=config.tau)
        self.optimiser = torch.optim.Adam(
            self.loss.parameters(), lr=config.learning_rate, fused=True
        )
        self._keys = [*self.loss.in_keys, *keys]
        # No prefetch: its threads would draw batches in an order that no seed fixes.
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size, device=config.device),
            sampler=sampler,
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
        sound = transitions.select(*self._keys)[is_sound]
        if sound.shape[0] > 0:
            self.buffer.extend(sound)
        return transitions.shape[0] - sound.shape[0]

    def update(self) -> TensorDict:
        """Take one gradient step, and return the losses and what else the loss reports."""
        losses = self.loss(self.buffer.sample())
        self.optimiser.zero_grad()
        sum(loss for name, loss in losses.items() if name.startswith("loss_")).backward()
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
