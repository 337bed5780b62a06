"""Reward terms as functions of ``[B]`` tensors."""

import torch
from torch import Tensor


def reward_approach(
    distance_before: Tensor, distance: Tensor, error_before: Tensor, error: Tensor
) -> Tensor:
    """Return +1 where distance or bearing error decreased, else -1; all ``[B]``.

    Either suffices, as in the paper ("bearing or distance shrinks"). No change gives -1. Distances
    and signed bearing errors, radians, are those at the last decision and now.
    """
    is_nearer = distance < distance_before
    is_better_aimed = error.abs() < error_before.abs()
    return torch.where(is_nearer | is_better_aimed, 1.0, -1.0)
