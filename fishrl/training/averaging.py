"""An average of a policy's weights over its training, which acts in place of the newest ones."""

from copy import deepcopy
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

from fishrl.training.scaling import Folding, InputScale


class WeightAverage:
    """Moving average of a policy's weights, one step of it after each gradient step.

    The first ``horizon`` steps form a plain mean, so that the initial weights do not count; later
    ones an exponential average with this time constant (Polyak & Juditsky 1992; Izmailov et al.
    2018, arXiv 1803.05407).

    Args:
        policy: the policy that learns.
        horizon: gradient steps; with 1 the average has the newest weights.
        scale: of what the policy reads, folded into the average; None if it reads observations.

    Attributes:
        policy: a copy of it that has the averaged weights.
    """

    def __init__(
        self, policy: TensorDictModuleBase, *, horizon: float, scale: InputScale | None = None
    ) -> None:
        self.policy = deepcopy(policy).requires_grad_(False)
        self._newest, self._mean = list(policy.parameters()), list(self.policy.parameters())
        self._fold = list if scale is None else Folding(policy, scale)
        self._least_rate = 1.0 / max(1.0, horizon)
        self._num_steps = torch.zeros((), device=self._mean[0].device)

    @torch.no_grad()
    def step(self) -> None:
        """Take in the newest weights; a sequence of tensor operations, see ``tracing.Traced``."""
        self._num_steps += 1.0
        rate = self._num_steps.reciprocal().clamp_min(self._least_rate)
        for mean, newest in zip(self._mean, self._fold(self._newest), strict=True):
            mean.lerp_(newest, rate)

    def state_dict(self) -> dict[str, Any]:
        """Return the number of steps; the policy has a state of its own."""
        return {"num_steps": self._num_steps.clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state of ``state_dict`` in place: a traced step keeps the tensor."""
        self._num_steps.copy_(state["num_steps"])
