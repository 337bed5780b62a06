"""What is read off a flow."""

import torch
from torch import Tensor


def compute_vorticity(u: Tensor) -> Tensor:
    """Return dv/dx - du/dy ``[B, Y, X]`` per step by central differences (one-sided at edges).

    Args:
        u: velocity ``[B, 2, Y, X]``.
    """
    (dv_dx,) = torch.gradient(u[:, 1], dim=-1)
    (du_dy,) = torch.gradient(u[:, 0], dim=-2)
    return dv_dx - du_dy


def compute_area(outline: Tensor) -> Tensor:
    """Return the area ``[B]`` enclosed by closed outlines ``[B, N, 2]``, nodes^2 (shoelace)."""
    x, y = outline.unbind(-1)
    return 0.5 * (x * y.roll(-1, -1) - y * x.roll(-1, -1)).sum(-1).abs()
