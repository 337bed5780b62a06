"""Regularised delta kernels: one-dimensional weights of the nodes around a marker.

The two-dimensional kernel is the product of two one-dimensional ones. All sum to one; all but the
hat have a constant sum of squares, so the force on a body does not depend on its position relative
to the nodes.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor


class Kernel(ABC):
    """A kernel phi(r) of compact support.

    Attributes:
        support: number of nodes per axis within reach of a marker.
        spectrum: upper bound of the marker coupling's eigenvalues for a closed body with a marker
            spacing of one node, whose sides may meet; limits the relaxation of the force iteration.
    """

    support: int
    spectrum: float

    def __call__(self, r: Tensor) -> Tensor:
        """Return phi at the distances ``r`` (nodes), of the same shape."""
        return self._evaluate(r.abs())

    @property
    def margin(self) -> float:
        """Distance from the edge nodes at which a marker's kernel reaches no node beyond them."""
        return 0.5 * self.support - 1.0

    @abstractmethod
    def _evaluate(self, a: Tensor) -> Tensor: ...


@dataclass(frozen=True)
class Hat(Kernel):
    """Linear two-point kernel 1 - abs(r)."""

    support = 2
    spectrum = 2.0

    def _evaluate(self, a: Tensor) -> Tensor:
        return (1.0 - a).clamp_min(0.0)


@dataclass(frozen=True)
class Roma3(Kernel):
    """Three-point kernel of Roma, Peskin & Berger 1999, eq. 22; sum of squares 1/2."""

    support = 3
    spectrum = 1.05

    def _evaluate(self, a: Tensor) -> Tensor:
        inner = (1.0 + (1.0 - 3.0 * a * a).clamp_min(0.0).sqrt()) * (1 / 3)
        b = 1.0 - a
        outer = (5.0 - 3.0 * a - (1.0 - 3.0 * b * b).clamp_min(0.0).sqrt()) * (1 / 6)
        return torch.where(a <= 0.5, inner, torch.where(a <= 1.5, outer, torch.zeros_like(a)))


@dataclass(frozen=True)
class Peskin4(Kernel):
    """Four-point kernel of Peskin 2002, eq. 6.27; sum of squares 3/8."""

    support = 4
    spectrum = 0.8

    def _evaluate(self, a: Tensor) -> Tensor:
        inner = (3.0 - 2.0 * a + (1.0 + 4.0 * a - 4.0 * a * a).clamp_min(0.0).sqrt()) * 0.125
        outer = (5.0 - 2.0 * a - (-7.0 + 12.0 * a - 4.0 * a * a).clamp_min(0.0).sqrt()) * 0.125
        return torch.where(a <= 1.0, inner, torch.where(a <= 2.0, outer, torch.zeros_like(a)))
