"""Numbers of a task as tensors that are made once: to copy them to a GPU is to wait for it."""

from functools import cache

import torch
from torch import Tensor

Numbers = tuple[float, ...] | tuple[tuple[float, ...], ...]


@cache
def make_constant(numbers: Numbers, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Return numbers as a tensor of a type on a device, not to be changed."""
    return torch.tensor(numbers, dtype=dtype, device=device)
