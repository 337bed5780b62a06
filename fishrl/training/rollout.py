"""What an on-policy algorithm collects before it learns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase


class Rollout:
    """Some decisions of each flow, one after another, completed by their advantages.

    Args:
        length: decisions of each flow.
        estimate: writes the advantages of transitions ``[B, length]``, whose rows are flows.
    """

    def __init__(self, length: int, estimate: Callable[[TensorDictBase], object]) -> None:
        self._length, self._estimate = length, estimate
        self._decisions: list[TensorDictBase] = []

    @property
    def is_complete(self) -> bool:
        """Whether the last ``add`` completed it."""
        return not self._decisions

    def add(self, decision: TensorDictBase) -> TensorDictBase | None:
        """Add a decision ``[B]`` of all flows; return all ``[B * length]`` if it completes them."""
        self._decisions.append(decision.clone())  # a collector reuses its memory
        if len(self._decisions) < self._length:
            return None
        whole = torch.stack(self._decisions, 1).contiguous()
        self._decisions = []
        with torch.no_grad():
            self._estimate(whole)
        return whole.reshape(-1)

    def state_dict(self) -> dict[str, Any]:
        """Return the decisions so far."""
        decisions = [decision.clone().to_dict() for decision in self._decisions]
        return {"decisions": decisions}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what ``state_dict`` returned."""
        self._decisions = [TensorDict.from_dict(d, batch_dims=1) for d in state["decisions"]]
