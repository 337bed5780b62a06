"""What an algorithm is to the training loop, and to those who evaluate what it has learned."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

from experiments.config import build
from experiments.settings import DEFAULT_ALGORITHM, TrainConfig
from fishrl.training.checkpoint import BrainOf
from fishrl.training.learner import Learner


class Algorithm(ABC):
    """A way to learn, made of its own settings; those that all share are in ``TrainConfig``.

    Attributes:
        label: part of a run folder's name; empty for the default.
    """

    label: str

    @abstractmethod
    def make_policy(
        self,
        brain: BrainOf,
        *,
        hidden: Sequence[int],
        generator: torch.Generator | None = None,
    ) -> TensorDictModuleBase:
        """Make what is evaluated and saved: a policy that is greedy under ``DETERMINISTIC``.

        Args:
            brain: the sizes it must have.
            hidden: widths of the hidden layers.
            generator: source of the initial weights.
        """

    @abstractmethod
    def make_learner(self, brain: BrainOf, config: TrainConfig) -> Learner:
        """Make a new brain and what it learns with; ``config.seed`` gives its weights."""


def build_algorithm(config: Mapping[str, Any]) -> Algorithm:
    """Make the algorithm of a run from its whole configuration, the default if it names none."""
    algorithm: Algorithm = build(config.get("algorithm") or DEFAULT_ALGORITHM)
    return algorithm
