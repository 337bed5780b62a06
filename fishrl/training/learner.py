"""The learner: policy, replay buffer and one gradient step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.envs import Transform
from torchrl.objectives import LossModule, SoftUpdate

from fishrl.training.rollout import Rollout
from fishrl.training.settings import LearningSettings
from fishrl.training.tracing import Traced


class Learner:
    """Replay buffer, loss with target networks, and optimiser; the same for every algorithm.

    Args:
        actor: the policy that is evaluated and saved, greedy under
            ``ExplorationType.DETERMINISTIC``.
        explorer: the policy that collects, with the same weights; the collector saves its state.
        loss: the sum of its entries ``loss_...`` is minimised; all are logged as ``train/<name>``.
        settings: settings that all algorithms share.
        device: where networks and buffer live.
        keys: entries of a transition that the sampler reads besides those of the loss.
        sampler: draws from the buffer; by default uniformly.
        transforms: of the environment that collects.
        is_traced: see ``Algorithm``.
        rollout_length: decisions of each flow that an on-policy algorithm learns from before it
            forgets them; None for all other algorithms.
        gae_lambda: of the advantages of an on-policy algorithm.
    """

    def __init__(
        self,
        *,
        actor: TensorDictModuleBase,
        explorer: TensorDictModuleBase,
        loss: LossModule,
        settings: LearningSettings,
        device: str = "cpu",
        keys: Sequence[Any] = (),
        sampler: Sampler | None = None,
        transforms: Sequence[Transform] = (),
        is_traced: bool = False,
        rollout_length: int | None = None,
        gae_lambda: float = 0.95,
    ) -> None:
        self.actor, self.explorer, self.loss = actor, explorer, loss
        self.reports, self.transforms = tuple(loss.out_keys), tuple(transforms)
        self.rollout: Rollout | None = None
        self.targets: SoftUpdate | None = None
        keys = [*self.loss.in_keys, *keys]
        if rollout_length is None:
            self.loss.make_value_estimator(gamma=settings.gamma)
            self.targets = SoftUpdate(self.loss, tau=settings.tau)
        else:
            self.loss.make_value_estimator(gamma=settings.gamma, lmbda=gae_lambda)
            self.rollout = Rollout(rollout_length, self._estimate)
            keys += ["advantage", "value_target"]
        self.optimiser = torch.optim.Adam(loss.parameters(), lr=settings.learning_rate, fused=True)
        self._is_traced, self._keys = is_traced, keys
        self._renew_step()
        # a checkpoint replaces the tensors of the optimiser, which a traced step has kept
        self.optimiser.register_load_state_dict_post_hook(self._renew_step)
        # No prefetch: its threads would draw batches in an order that no seed fixes.
        self.buffer = TensorDictReplayBuffer(
            storage=_ZeroedStorage(settings.buffer_size, device=device),
            sampler=sampler,
            batch_size=settings.batch_size,
            prefetch=0,
        )

    def store(self, transitions: TensorDictBase) -> int:
        """Store transitions ``[N]`` except diverged ones, and return how many those are.

        An on-policy algorithm needs one decision of each flow at a time, in the same order. They
        replace those of the last rollout once they are complete.
        """
        mask = transitions.get(("next", "action_mask"))
        if mask is not None and not mask.any(-1).all():
            raise ValueError(
                "action_mask: a state has no legal action; every state needs one, also a final one"
            )
        num_diverged = int(transitions["next", "diverged"].sum())
        if self.rollout is not None:
            whole = self.rollout.add(transitions.select(*self.loss.in_keys, ("next", "diverged")))
            if whole is None:
                return num_diverged
            self.buffer.empty()
            transitions = whole
        valid = transitions.select(*self._keys)[~transitions["next", "diverged"].reshape(-1)]
        if valid.shape[0] > 0:
            self.buffer.extend(valid)
        return num_diverged

    @property
    def is_ready(self) -> bool:
        """Whether there is something to learn from."""
        return len(self.buffer) > 0 and (self.rollout is None or self.rollout.is_complete)

    def _estimate(self, transitions: TensorDictBase) -> None:
        """Write the advantages and value targets of transitions ``[B, T]``.

        A row that diverged bootstraps from its last state, as if it had been truncated there.
        """
        loss: Any = self.loss
        networks = {
            "params": loss.critic_network_params,
            "target_params": loss.target_critic_network_params,
        }
        loss.value_estimator(transitions, **networks)

    def update(self) -> dict[str, Tensor]:
        """Take one gradient step and return all outputs of the loss by name."""
        batch = self.buffer.sample()
        self._names, values = zip(*batch.items(True, True), strict=True)
        losses = self._step(*values)
        return dict(zip(self.reports, losses, strict=True))

    def _renew_step(self, *_: Any) -> None:
        self._step = Traced(self._take_step) if self._is_traced else self._take_step

    def _take_step(self, *tensors: Tensor) -> list[Tensor]:
        """Take a gradient step on the entries ``_names`` of a batch."""
        batch = TensorDict(dict(zip(self._names, tensors, strict=True)), tensors[0].shape[:1])
        losses = self.loss(batch)
        self.optimiser.zero_grad()
        sum(loss for name, loss in losses.items() if name.startswith("loss_")).backward()
        self.optimiser.step()
        if self.targets is not None:
            self.targets.step()
        return [losses[name].detach() for name in self.reports]

    def components(self) -> dict[str, Any]:
        """Return by name what a checkpoint holds of the learner."""
        rollout = {} if self.rollout is None else {"rollout": self.rollout}
        return {
            **rollout,
            "actor": self.actor,
            "loss": self.loss,
            "optimiser": self.optimiser,
            "buffer": self.buffer,
        }


class _ZeroedStorage(LazyTensorStorage):
    """Storage whose unwritten rows are zero: checkpoints hold no left-over memory."""

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
