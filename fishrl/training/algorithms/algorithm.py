"""What an algorithm is to the training loop, and to whoever evaluates what it has learned."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModuleBase

from fishrl.training.learner import Learner
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings


class Algorithm(ABC):
    """A way to learn: a frozen dataclass of its own settings.

    What all algorithms share is in ``LearningSettings``.
    """

    @property
    @abstractmethod
    def label(self) -> str:
        """Part of a run folder's name; empty for the default algorithm."""

    @abstractmethod
    def make_policy(
        self,
        spec: PolicySpec,
        *,
        hidden: Sequence[int],
        generator: torch.Generator | None = None,
    ) -> TensorDictModuleBase:
        """Make what is evaluated and saved: a policy that is greedy under ``DETERMINISTIC``.

        Args:
            spec: the sizes it must have.
            hidden: widths of the hidden layers.
            generator: source of the initial weights.
        """

    @abstractmethod
    def make_learner(
        self, spec: PolicySpec, settings: LearningSettings, *, device: str = "cpu"
    ) -> Learner:
        """Make a new policy and what trains it; ``settings.seed`` gives the initial weights."""
