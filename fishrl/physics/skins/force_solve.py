"""The force at the markers of an immersed boundary that removes the slip: A g = r."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt
from torch import Tensor

from fishrl.physics.skins.delta import SPECTRUM
from fishrl.settings import Settings


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
