"""Reward terms as functions of ``[B]`` tensors."""

import torch
from torch import Tensor


def reward_approach(
    distance_before: Tensor, distance: Tensor, error_before: Tensor, error: Tensor
) -> Tensor:
    """Return +1 where distance or bearing error decreased, else -1.

    Either suffices, as in the paper ("bearing or distance shrinks"). No change gives -1.

    Args:
        distance_before: ``[B]`` distance at the last decision.
        distance: ``[B]`` distance now.
        error_before: ``[B]`` signed bearing error at the last decision, radians.
        error: ``[B]`` bearing error now.
    """
    is_nearer = distance < distance_before
    is_better_aimed = error.abs() < error_before.abs()
    return torch.where(is_nearer | is_better_aimed, 1.0, -1.0)
