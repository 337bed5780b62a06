"""The regularised delta kernel: one-dimensional weights of the nodes around a marker.

The three-point kernel of Roma, Peskin & Berger 1999, eq. 22; in two dimensions the product of two.
Its weights sum to one and their squares to 1/2, so the force on a body does not depend on its
position relative to the nodes.
"""

import torch
from torch import Tensor

#: Nodes per axis within reach of a marker.
SUPPORT = 3

#: Upper bound of the marker coupling's eigenvalues for a closed body with a marker spacing of one
#: node, whose sides may meet; limits the relaxation of the force iteration.
SPECTRUM = 1.05


def evaluate_delta(r: Tensor) -> Tensor:
    """Return phi at the distances ``r`` (nodes), of the same shape."""
    a = r.abs()
    inner = (1.0 + (1.0 - 3.0 * a * a).clamp_min(0.0).sqrt()) * (1 / 3)
    b = 1.0 - a
    outer = (5.0 - 3.0 * a - (1.0 - 3.0 * b * b).clamp_min(0.0).sqrt()) * (1 / 6)
    return torch.where(a <= 0.5, inner, torch.where(a <= 1.5, outer, torch.zeros_like(a)))
