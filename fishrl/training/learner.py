"""The learner: policy, buffer and gradient step; subclasses decide what the buffer holds.

``OffPolicyLearner`` replays past transitions, ``OnPolicyLearner`` learns from each rollout of the
current policy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.envs import Transform
from torchrl.objectives import LossModule

from fishrl.training.settings import LearningSettings
from fishrl.training.tracing import Traced


class Networks(NamedTuple):
    """The networks of an algorithm, on the device where they learn.

    Attributes:
        actor: policy that is evaluated and saved, greedy under ``ExplorationType.DETERMINISTIC``.
        explorer: policy that collects, with the same weights; the collector saves its state.
        loss: the sum of its outputs ``loss_...`` is minimised; all are logged as ``train/<name>``.
    """

    actor: TensorDictModuleBase
    explorer: TensorDictModuleBase
    loss: LossModule


class Learner(ABC):
    """Store transitions and take gradient steps on batches of them.

    Args:
        networks: of the algorithm.
        settings: learning rate, batch size and buffer size.
        keys: entries of a transition to store in addition to those that the loss reads.
        sampler: draws batches from the buffer; by default uniformly.
        transforms: transforms that the explorer needs in its environment.
        is_traced: see ``Algorithm``.
    """

    def __init__(
        self,
        networks: Networks,
        settings: LearningSettings,
        *,
        keys: Sequence[Any] = (),
        sampler: Sampler | None = None,
        transforms: Sequence[Transform] = (),
        is_traced: bool = False,
    ) -> None:
        self.actor, self.explorer, self.loss = networks
        self.reports, self.transforms = tuple(self.loss.out_keys), tuple(transforms)
        self._keys, self._is_traced = [*self.loss.in_keys, *keys], is_traced
        self.optimiser = torch.optim.Adam(
            self.loss.parameters(), lr=settings.learning_rate, fused=True
        )
        self._renew_step()
        # A checkpoint replaces the tensors of the optimiser, which a traced step has kept.
        self.optimiser.register_load_state_dict_post_hook(self._renew_step)
        # No prefetch: its threads would draw batches in an order that no seed fixes.
        self.buffer = TensorDictReplayBuffer(
            storage=_ZeroedStorage(
                settings.buffer_size, device=next(self.actor.parameters()).device
            ),
            sampler=sampler,
            batch_size=settings.batch_size,
            prefetch=0,
        )

    def store(self, transitions: TensorDictBase) -> int:
        """Store transitions ``[N]`` except diverged ones, and return the number of those.

        Raises:
            ValueError: if a state has no legal action.
        """
        mask = transitions.get(("next", "action_mask"))
        if mask is not None and not mask.any(-1).all():
            raise ValueError(
                "action_mask: a state has no legal action; every state needs one, final ones too"
            )
        self._remember(transitions)
        return int(transitions["next", "diverged"].sum())

    @abstractmethod
    def _remember(self, transitions: TensorDictBase) -> None:
        """Add transitions ``[N]`` to the buffer, now or once enough of them are complete."""

    def _extend(self, transitions: TensorDictBase) -> None:
        valid = transitions.select(*self._keys)[~transitions["next", "diverged"].reshape(-1)]
        if valid.shape[0] > 0:
            self.buffer.extend(valid)

    @property
    def is_ready(self) -> bool:
        """Whether there are transitions to learn from."""
        return len(self.buffer) > 0

    def update(self) -> dict[str, Tensor]:
        """Take one gradient step and return all outputs of the loss by name."""
        return dict(zip(self.reports, self._step(self.buffer.sample()), strict=True))

    def _take_step(self, batch: TensorDictBase) -> list[Tensor]:
        losses = self.loss(batch)
        self.optimiser.zero_grad()
        sum(loss for name, loss in losses.items() if name.startswith("loss_")).backward()
        self.optimiser.step()
        return [losses[name].detach() for name in self.reports]

    def _renew_step(self, *_: Any) -> None:
        self._step = Traced(self._take_step) if self._is_traced else self._take_step

    def components(self) -> dict[str, Any]:
        """Return by name what a checkpoint holds of the learner."""
        return {
            "actor": self.actor,
            "loss": self.loss,
            "optimiser": self.optimiser,
            "buffer": self.buffer,
        }


class _ZeroedStorage(LazyTensorStorage):
    """Storage whose unwritten rows are zero, so that checkpoints hold no uninitialised memory."""

    def _init(self, *args: Any, **kwargs: Any) -> None:
        super()._init(*args, **kwargs)
        self._storage.zero_()


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one CPU thread: networks this small gain nothing from more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
