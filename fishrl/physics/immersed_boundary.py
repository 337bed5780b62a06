"""Immersed boundary: markers and nodes exchange velocity and force through a delta kernel.

With weights W_l(x) of marker l and spacing ds, interpolation is U_l = sum_x W_l u and the force
2 rho W_l g_l ds at the nodes adds the velocity A g at the markers, A_kl = ds sum_x W_k W_l. No slip
means A g = U_d - U*. Everything here works on the marker side: A is a small dense matrix, and
iterating needs no pass over the grid.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import torch
from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt
from torch import Tensor

from fishrl.physics.delta import SPECTRUM, SUPPORT, evaluate_delta
from fishrl.settings import Settings


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


class ForceSolve(Settings, ABC):
    """A method that solves A g = r for the force g at the markers."""

    def prepare(self, overlap: Tensor, spacing: Tensor) -> tuple[Tensor, ...]:
        """Return what the solve needs of the marker positions; once where bodies stay still.

        ``overlap`` ``[B, N, N]`` is from ``overlap_markers``, ``spacing`` ``[B, N]`` is ds. The
        first tensor returned is A^T ``[B, N, N]``.
        """
        return (spacing[..., None] * overlap,)

    @abstractmethod
    def __call__(self, operator: Sequence[Tensor], residual: Tensor) -> tuple[Tensor, Tensor]:
        """Solve for several right-hand sides at once; return g and the residual r - A g.

        ``operator`` is from ``prepare``; ``residual`` r ``[B, R, N]`` has one row per right-hand
        side (rows times A^T are three times faster than A times columns), like both results.
        """


class IterativeForcing(ForceSolve):
    """Iterative force correction, the paper's eq. 4: g += w r, r -= w A r.

    The factor 2 of eq. 4, times rho, is the half-force of the forcing scheme, part of F = 2 rho g;
    the paper's form (Zhang et al. 2016) is w = 1, see ``zhang``. Smooth body motion lies in the
    upper part of A's spectrum, so a constant w near the stability limit performs as well as
    Chebyshev factors (measured for both: 2 % slip after 3 iterations, 1 % after 4).

    Args:
        num_iterations: K.
        relaxation: w; stable up to 2 / ``delta.SPECTRUM``.
    """

    num_iterations: PositiveInt = 4
    relaxation: PositiveFloat = 1.7

    @classmethod
    def zhang(cls, num_iterations: int = 10) -> "IterativeForcing":
        """Return the paper's iteration."""
        return cls(num_iterations=num_iterations, relaxation=1.0)

    def __post_init__(self) -> None:
        limit = 2.0 / SPECTRUM
        if self.relaxation > limit:
            raise ValueError(
                f"relaxation = {self.relaxation}: the iteration is stable up to {limit:.2f}"
            )

    def __call__(self, operator: Sequence[Tensor], residual: Tensor) -> tuple[Tensor, Tensor]:
        """Iterate; linear in ``residual``."""
        solution = torch.zeros_like(residual)
        for _ in range(self.num_iterations):
            step = self.relaxation * residual
            solution = solution + step
            residual = residual - step @ operator[0]
        return solution, residual


class DirectSolve(ForceSolve):
    """Exact no slip by inverting A (Wu & Shu 2009); for bodies that stay still, and as reference.

    Args:
        regularisation: added to the diagonal of A, relative to its mean; a thin trailing edge makes
            A nearly singular, and single precision needs about 1e-4. A cylinder needs none.
    """

    regularisation: NonNegativeFloat = 1e-4

    def prepare(self, overlap: Tensor, spacing: Tensor) -> tuple[Tensor, ...]:
        """Return A^T and its inverse, computed in double precision by Cholesky factorisation."""
        root = spacing.double().sqrt()
        matrix = root[..., None] * overlap.double() * root[:, None]
        diagonal = torch.diagonal(matrix, dim1=-2, dim2=-1)
        shift = self.regularisation * diagonal.mean(-1, keepdim=True)
        # a diverged flow (not finite) must not stop its neighbours: factor, never raise
        factor, _ = torch.linalg.cholesky_ex(matrix + torch.diag_embed(shift.expand_as(diagonal)))
        inverse = root[..., None] * torch.cholesky_inverse(factor) / root[:, None]
        return spacing[..., None] * overlap, inverse.to(overlap.dtype)

    def __call__(self, operator: Sequence[Tensor], residual: Tensor) -> tuple[Tensor, Tensor]:
        """Apply the inverse, with one step of iterative refinement."""
        coupling, inverse = operator
        solution = residual @ inverse
        solution = solution + (residual - solution @ coupling) @ inverse
        return solution, residual - solution @ coupling
