"""The interface of an algorithm; read this before adding one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.objectives import LossModule

from fishrl.bounds import Checked
from fishrl.envs import AbstractTask
from fishrl.training.learner import Learner
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings


class Algorithm(Checked, ABC):
    """Base of all algorithms: a frozen dataclass of the settings that only this algorithm has.

    With the class attribute ``is_traced`` the tensor operations of one gradient step are repeated
    at all others (``tracing.Traced``), with the same numbers in half the time. The loss must then
    perform the same operations at every step, without branches on the values of tensors and without
    numbers that change.

    The class attributes ``takes_discrete`` and ``takes_continuous`` say which actions it learns;
    by default discrete ones. Several fish in a flow are treated as if each had a flow of its own,
    unless ``takes_several`` is false, which excludes such tasks.
    """

    is_traced: ClassVar[bool] = False
    takes_discrete: ClassVar[bool] = True
    takes_continuous: ClassVar[bool] = False
    takes_several: ClassVar[bool] = True

    @property
    def label(self) -> str:
        """Part of a run folder's name: by default that of the class."""
        return type(self).__name__.lower()

    @classmethod
    def takes(cls, task: AbstractTask) -> bool:
        """Return whether it learns the actions of a task."""
        fits = cls.takes_discrete if task.action_bounds is None else cls.takes_continuous
        return fits and (cls.takes_several or task.num_fish == 1)

    def adapt(self, settings: LearningSettings) -> LearningSettings:
        """Return the common settings with those that follow from this algorithm's own."""
        return settings

    @abstractmethod
    def make_policy(
        self, spec: PolicySpec, *, hidden: Sequence[int], generator: torch.Generator | None = None
    ) -> Any:
        """Make the policy that is evaluated and saved, greedy under ``DETERMINISTIC``.

        ``hidden`` are the widths of the hidden layers, ``generator`` draws the initial weights.
        """

    @abstractmethod
    def make_loss(
        self, policy: Any, spec: PolicySpec, *, hidden: Sequence[int], generator: torch.Generator
    ) -> LossModule:
        """Make the loss that trains the policy, its further networks on the policy's device."""

    def make_explorer(self, policy: Any, spec: PolicySpec, *, device: str) -> TensorDictModuleBase:
        """Make the policy that collects, with the same weights; by default the policy itself."""
        return policy

    def choose_sampling(self, policy: Any, settings: LearningSettings) -> dict[str, Any]:
        """Return further arguments of ``Learner``, such as its ``sampler``; by default none.

        Without a sampler transitions are drawn uniformly; ``DRQN`` draws sequences, and ``PPO``
        learns from rollouts.
        """
        return {}

    def make_learner(
        self, spec: PolicySpec, settings: LearningSettings, *, device: str = "cpu"
    ) -> Learner:
        """Make a new policy and its learner; ``settings.seed`` fixes the initial weights.

        Of several fish, the buffer holds the decisions of each.
        """
        generator = torch.Generator().manual_seed(settings.seed)
        policy = self.make_policy(spec, hidden=settings.hidden, generator=generator).to(device)
        loss = self.make_loss(policy, spec, hidden=settings.hidden, generator=generator)
        return Learner(
            actor=policy,
            explorer=self.make_explorer(policy, spec, device=device),
            loss=loss,
            settings=replace(settings, buffer_size=settings.buffer_size * spec.num_fish),
            device=device,
            is_traced=self.is_traced,
            **self.choose_sampling(policy, settings),
        )
