"""The regularised delta kernel: one-dimensional weights of the nodes around a marker.

The three-point kernel of Roma, Peskin & Berger 1999, eq. 22; in two dimensions the product of two.
Its weights sum to one and their squares to 1/2, so the force on a body does not depend on its
position relative to the nodes.
"""

from typing import NamedTuple

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


class Stencil(NamedTuple):
    """The nodes around each marker; S is the kernel's support. Markers come last in memory."""

    x: Tensor  #: ``[B, N]`` column of the first node, a whole number in the weights' type
    y: Tensor  #: ``[B, N]`` row of the first node
    weight_x: Tensor  #: ``[B, S, N]`` kernel weights along x
    weight_y: Tensor  #: ``[B, S, N]`` kernel weights along y

    @property
    def weights(self) -> Tensor:
        """Two-dimensional weights ``[B, S * S, N]``, y before x."""
        return (self.weight_y[:, :, None] * self.weight_x[:, None]).flatten(1, 2)

    def index_nodes(self, row_length: int) -> Tensor:
        """Return ``[B, S * S, N]`` flat node indices in a row-major field, y before x."""
        s = torch.arange(self.weight_x.shape[1], device=self.x.device)[:, None]
        rows = (self.y.to(torch.int64)[:, None] + s) * row_length
        columns = self.x.to(torch.int64)[:, None] + s
        return (rows[:, :, None] + columns[:, None]).flatten(1, 2)


def make_stencil(markers: Tensor, width: int, height: int, dtype: torch.dtype) -> Stencil:
    """Find each marker's nodes and weights.

    Args:
        markers: ``[B, N, 2]`` positions (x, y) in nodes.
        width: number of nodes along x; markers outside are clamped to the edge, so that a body
            outside the domain (reported as diverged) reads no other flow's memory.
        height: number of nodes along y.
        dtype: of the weights.
    """
    reach = 0.5 * SUPPORT
    steps = torch.arange(SUPPORT, device=markers.device, dtype=dtype)[:, None]
    first, weights = [], []
    for axis, size in ((0, width), (1, height)):
        position = markers[..., axis].nan_to_num(0.0).clamp(0.0, size - 1.0)
        start = (torch.floor(position - reach) + 1.0).clamp(0.0, float(size - SUPPORT))
        offset = (position - start).to(dtype)
        first.append(start.to(dtype))
        weights.append(evaluate_delta(offset[:, None] - steps))
    return Stencil(first[0], first[1], weights[0], weights[1])


def interpolate(values: Tensor, weights: Tensor) -> Tensor:
    """Return marker values ``[B, N]`` from node values ``[B, S * S, N]`` at each stencil."""
    return (values * weights).sum(1)


def overlap_markers(stencil: Stencil) -> Tensor:
    """Return sum_x W_k W_l ``[B, N, N]``, symmetric; A_kl is ds_l times it.

    The product form of the kernel makes it separable: (Px Px^T) * (Py Py^T).
    """
    along_x = _overlap(stencil.x, stencil.weight_x)
    return along_x * _overlap(stencil.y, stencil.weight_y)


def _overlap(first: Tensor, weights: Tensor) -> Tensor:
    """Return sum_i phi(i - X_k) phi(i - X_l) for all marker pairs, ``[B, N, N]``."""
    support = weights.shape[1]
    shift = first[:, None, :] - first[:, :, None]
    total = torch.zeros_like(shift)
    for d in range(1 - support, support):
        pairs = range(max(0, d), min(support, support + d))
        products = sum(weights[:, a, :, None] * weights[:, a - d, None, :] for a in pairs)
        total = torch.where(shift == d, products, total)
    return total
