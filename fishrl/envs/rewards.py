"""Bricks that tasks build their rewards from, as free functions of ``[B]`` tensors."""

import torch
from torch import Tensor


def reward_approach(
    distance_before: Tensor, distance: Tensor, error_before: Tensor, error: Tensor
) -> Tensor:
    """Return +1 where the fish came nearer to its target or turned towards it, else -1.

    Either is enough: the paper's "bearing or distance shrinks", taken literally. Standing still is
    no progress.

    Args:
        distance_before: ``[B]`` distance at the last decision.
        distance: ``[B]`` distance now.
        error_before: ``[B]`` bearing error at the last decision, radians, of any sign.
        error: ``[B]`` bearing error now.
    """
    is_nearer = distance < distance_before
    is_better_aimed = error.abs() < error_before.abs()
    return torch.where(is_nearer | is_better_aimed, 1.0, -1.0)
