"""Inputs of unit scale: networks read observations as (value - mean) / deviation."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

#: Deviation below which a number counts as constant and is only shifted: the senses are of order
#: one, and what rests in the warm-up may change later.
CONSTANT = 1e-3


class InputScale(nn.Module):
    """Mean and deviation of observations, the same for all observations of a stack.

    Until ``measure_`` is called they are 0 and 1.

    Args:
        stacks: entries, with their lengths and the numbers of stacked observations.
    """

    is_measured: Tensor

    def __init__(self, stacks: Mapping[str, tuple[int, int]]) -> None:
        super().__init__()
        self.stacks = dict(stacks)
        self.register_buffer("is_measured", torch.zeros((), dtype=torch.bool))
        for key, (length, _) in stacks.items():
            self.register_buffer(f"{key}_mean", torch.zeros(length))
            self.register_buffer(f"{key}_deviation", torch.ones(length))

    def read(self, key: str) -> tuple[Tensor, Tensor]:
        """Return mean and deviation of an entry."""
        return self.get_buffer(f"{key}_mean"), self.get_buffer(f"{key}_deviation")

    @torch.no_grad()
    def measure_(self, data: TensorDictBase) -> None:
        """Set mean and deviation to those of data ``[N]``."""
        for key, (_, num_stacked) in self.stacks.items():
            numbers = data[key].unflatten(-1, (num_stacked, -1)).flatten(0, -2).double()
            deviation, mean = torch.std_mean(numbers, 0, correction=0)
            deviation = deviation.masked_fill(deviation < CONSTANT, 1.0)
            for kept, value in zip(self.read(key), (mean, deviation), strict=True):
                kept.copy_(value.repeat(num_stacked))
        self.is_measured.fill_(True)

    def forward(self, data: TensorDictBase) -> TensorDictBase:
        """Return data with scaled entries, also under ``next``, and leave the given ones."""
        scaled = data.copy()
        for key in self.stacks:
            mean, deviation = self.read(key)
            for place in (key, ("next", key)):
                if place in data.keys(True):
                    scaled[place] = (data[place] - mean) / deviation
        return scaled


class ScaledPolicy(TensorDictModuleBase):
    """A policy that reads scaled observations, for data that holds the observations themselves."""

    def __init__(self, policy: TensorDictModuleBase, scale: InputScale) -> None:
        super().__init__()
        self.policy, self.scale = policy, scale
        self.in_keys, self.out_keys = policy.in_keys, policy.out_keys

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write what the policy writes."""
        after = self.policy(self.scale(tensordict))
        return tensordict.update(after.exclude(*self.scale.stacks))


class Folding:
    """Fold a scale into the weights of a policy, so that it reads the observations themselves.

    The first layer is ``W (x - mean) / deviation + b = W' x + b'``.

    Args:
        policy: its first layer, an ``nn.Linear`` or ``nn.LSTM``, reads one of the scaled entries.
        scale: the scale.

    Raises:
        ValueError: for another first layer.
    """

    def __init__(self, policy: TensorDictModuleBase, scale: InputScale) -> None:
        layers = (each for each in policy.modules() if isinstance(each, nn.Linear | nn.LSTM))
        first = next(layers, None)
        end = "_ih_l0" if isinstance(first, nn.LSTM) else ""
        weight, bias = f"weight{end}", f"bias{end}"
        entries = [key for key in scale.stacks if key in policy.in_keys]
        if first is None or getattr(first, bias) is None or len(entries) != 1:
            raise ValueError(
                f"scale_inputs: the policy reads {list(policy.in_keys)}; its first layer must be "
                f"an nn.Linear or nn.LSTM with a bias that reads one of {list(scale.stacks)}"
            )
        self._weight, self._bias = getattr(first, weight), getattr(first, bias)
        self._mean, self._deviation = scale.read(entries[0])

    def __call__(self, weights: list[Tensor]) -> list[Tensor]:
        """Return weights of the policy with those of the first layer folded."""
        folded = self._weight / self._deviation
        changed = {id(self._weight): folded, id(self._bias): self._bias - folded @ self._mean}
        return [changed.get(id(weight), weight) for weight in weights]

    @torch.no_grad()
    def undo_(self) -> None:
        """Let a policy that reads observations read scaled ones, with the same result."""
        self._bias += self._weight @ self._mean
        self._weight *= self._deviation
