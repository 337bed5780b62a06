"""The interface of an algorithm; read this before adding one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModuleBase

from fishrl.training.learner import Learner
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.settings import LearningSettings


class Algorithm(ABC):
    """Base of all algorithms: a frozen dataclass of the settings that only this algorithm has.

    ``LearningSettings`` holds the settings that all algorithms share.
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
        """Make the policy that is evaluated and saved, greedy under ``DETERMINISTIC``.

        Args:
            spec: sizes of the policy.
            hidden: widths of the hidden layers.
            generator: source of the initial weights.
        """

    @abstractmethod
    def make_learner(
        self, spec: PolicySpec, settings: LearningSettings, *, device: str = "cpu"
    ) -> Learner:
        """Make a new policy and its learner; ``settings.seed`` fixes the initial weights."""
