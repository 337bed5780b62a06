"""Boundary conditions on the four edges of the domain.

A boundary sets the *incoming* populations of the edge nodes after streaming. Edges that need only
their own nodes go first, then those that look at a neighbour: left and right, and last bottom and
top, so that every neighbour is complete when it is read. One function per boundary serves the
readable step and the in-place step alike: it takes views of one edge and returns new values.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import Enum
from typing import ClassVar

from torch import Tensor

from fishrl.physics.collision import compute_equilibrium, compute_macroscopic
from fishrl.physics.lattice import CX, CY, OPPOSITE


class Side(Enum):
    """An edge of the domain; the value is its inward normal (x, y)."""

    LEFT = (1, 0)
    RIGHT = (-1, 0)
    BOTTOM = (0, 1)
    TOP = (0, -1)

    @property
    def edge(self) -> tuple[slice | int, ...]:
        """Index of the edge nodes in ``[B, Y, X]``."""
        return self._index(0, -1)

    @property
    def neighbour(self) -> tuple[slice | int, ...]:
        """Index of the nodes next to the edge, along the inward normal."""
        return self._index(1, -2)

    def _index(self, low: int, high: int) -> tuple[slice | int, ...]:
        x, y = self.value
        everything = slice(None)
        if x:
            return everything, everything, low if x > 0 else high
        return everything, low if y > 0 else high, everything


class Boundary(ABC):
    """What happens at one edge.

    Attributes:
        is_local: whether the edge's own outgoing populations suffice.
    """

    is_local: ClassVar[bool] = False

    @abstractmethod
    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor]
    ) -> dict[int, Tensor]:
        """Return the incoming populations to set on the edge, by direction.

        Args:
            side: which edge.
            neighbour: nine incoming populations of the nodes next to the edge.
            outgoing: nine post-collision populations of the edge nodes themselves.
        """


@dataclass(frozen=True, kw_only=True)
class NonEquilibrium(Boundary):
    """Non-equilibrium extrapolation of Guo, Zheng & Shi 2002, eq. 6 (second order).

    f_b = f_eq(rho_b, u_b) + f_n - f_eq(rho_n, u_n), with n the inner neighbour. What is not given
    is taken from the neighbour.

    Args:
        velocity: (x, y) in lattice units; (0, 0) is a wall at rest.
        density: rho; give it (1.0) at an outlet, which pins the pressure.
    """

    velocity: tuple[float, float] | None = None
    density: float | None = None

    def __post_init__(self) -> None:
        """Refuse a boundary that prescribes nothing."""
        if self.velocity is None and self.density is None:
            raise ValueError("NonEquilibrium prescribes nothing: give velocity, density or both")

    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor]
    ) -> dict[int, Tensor]:
        """Return all nine populations."""
        rho, jx, jy = compute_macroscopic(neighbour)
        ux, uy = jx / (rho + 1.0), jy / (rho + 1.0)
        rho_b = rho if self.density is None else 0.0 * rho + (self.density - 1.0)
        ux_b = ux if self.velocity is None else 0.0 * ux + self.velocity[0]
        uy_b = uy if self.velocity is None else 0.0 * uy + self.velocity[1]
        equilibrium = compute_equilibrium(rho, ux, uy)
        target = compute_equilibrium(rho_b, ux_b, uy_b)
        return {
            q: t + (f - e)
            for q, (t, f, e) in enumerate(zip(target, neighbour, equilibrium, strict=True))
        }


@dataclass(frozen=True)
class NoSlip(Boundary):
    """Half-way bounce-back: a wall half a node outside the edge nodes (Ladd 1994)."""

    is_local = True

    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor]
    ) -> dict[int, Tensor]:
        """Return the populations that come from outside."""
        nx, ny = side.value
        inward = [q for q in range(len(CX)) if CX[q] * nx + CY[q] * ny > 0]
        return {q: outgoing[OPPOSITE[q]] for q in inward}


@dataclass(frozen=True)
class Periodic(Boundary):
    """The flow leaves on one side and enters on the other; streaming itself does it."""

    is_local = True

    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor]
    ) -> dict[int, Tensor]:
        """Return nothing to set."""
        return {}


@dataclass(frozen=True, kw_only=True)
class Boundaries:
    """The four edges; the default is a closed tank."""

    left: Boundary = NonEquilibrium(velocity=(0.0, 0.0))
    right: Boundary = NonEquilibrium(velocity=(0.0, 0.0))
    bottom: Boundary = NonEquilibrium(velocity=(0.0, 0.0))
    top: Boundary = NonEquilibrium(velocity=(0.0, 0.0))

    def __post_init__(self) -> None:
        """Refuse half a period."""
        for a, b in (("left", "right"), ("bottom", "top")):
            if isinstance(getattr(self, a), Periodic) != isinstance(getattr(self, b), Periodic):
                raise ValueError(f"{a} and {b} must both be Periodic or neither")

    @property
    def is_periodic(self) -> bool:
        """Whether any edge is periodic."""
        return any(isinstance(getattr(self, f.name), Periodic) for f in fields(self))

    def in_order(self) -> list[list[tuple[Side, Boundary]]]:
        """Return the edges in the order in which they are set; edges of one list at once."""
        across = [(Side.LEFT, self.left), (Side.RIGHT, self.right)]
        along = [(Side.BOTTOM, self.bottom), (Side.TOP, self.top)]
        groups = [
            [edge for edge in across + along if edge[1].is_local],
            [edge for edge in across if not edge[1].is_local],
            [edge for edge in along if not edge[1].is_local],
        ]
        return [group for group in groups if group]


def apply_boundaries_(
    incoming: Sequence[Tensor], outgoing: Sequence[Tensor], boundaries: Boundaries
) -> None:
    """Set the edge nodes of nine ``[B, Y, X]`` incoming populations in place."""
    for group in boundaries.in_order():
        for side, boundary in group:
            neighbour = [f[side.neighbour] for f in incoming]
            edge = boundary.compute_edge(side, neighbour, [f[side.edge] for f in outgoing])
            for q, values in edge.items():
                incoming[q][side.edge] = values
