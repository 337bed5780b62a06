"""Boundary conditions on the four edges of the domain.

A boundary sets the *incoming* populations of the edge nodes after streaming. Edges that need only
their own nodes go first, then those that read a neighbour: left and right, then bottom and top, so
that every neighbour is complete when it is read. The readable and the in-place step share one
function per boundary, which takes views of one edge and returns new values.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from enum import Enum
from typing import Annotated, ClassVar

import torch
from pydantic import Field
from torch import Tensor

from fishrl.physics.collision import Macroscopic, compute_equilibrium, compute_macroscopic
from fishrl.physics.lattice import CX, CY, OPPOSITE, W
from fishrl.settings import Settings

Index = tuple[slice, slice, slice]


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


class Profile(Enum):
    """How a prescribed velocity varies along its edge, from wall to wall."""

    UNIFORM = "uniform"
    PARABOLA = "parabola"  # 4 s (1 - s): a developed channel flow, 1 in the middle
    SHEAR = "shear"  # 2 s - 1: a Couette flow between walls at -1 and 1

    def evaluate(self, s: Tensor) -> Tensor:
        """Return the factor at ``s``, 0 at one wall and 1 at the other."""
        if self is Profile.PARABOLA:
            return 4.0 * s * (1.0 - s)
        return 2.0 * s - 1.0 if self is Profile.SHEAR else torch.ones_like(s)


class Boundary(ABC):
    """What happens at one edge.

    Attributes:
        is_local: whether the edge's own outgoing populations suffice.
        ignores_side: whether the same happens at every edge. The fast step may then set two at
            once: tensors are ``[B, 2, n]``, the speed ``[B, 1, n + 2]``.
        velocity: (x, y) that it imposes, in units of the flow's stream speed; None leaves it free.
        profile: how that velocity varies along the edge.
    """

    is_local: ClassVar[bool] = False
    ignores_side: ClassVar[bool] = False
    velocity: tuple[float | None, float | None] | None
    profile: Profile

    @property
    def imposed_velocity(self) -> tuple[float, float]:
        """``velocity``, with 0 for what is free."""
        x, y = self.velocity or (None, None)
        return x or 0.0, y or 0.0

    @abstractmethod
    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor], speed: Tensor
    ) -> dict[int, Tensor]:
        """Return the incoming populations to set on the edge, by direction.

        Args:
            side: which edge.
            neighbour: nine incoming populations ``[B, n]`` of the nodes next to the edge.
            outgoing: nine post-collision populations of the edge nodes themselves.
            speed: stream speed times profile, ``[B, n + 2]``: at the edge's nodes and, first and
                last, at the corners beyond them.
        """


def _extrapolate(
    neighbour: Sequence[Tensor], fluid: Macroscopic, target: Macroscopic
) -> dict[int, Tensor]:
    """Return f_eq(target) + f_n - f_eq(fluid): the neighbour's non-equilibrium part is kept."""
    pairs = zip(compute_equilibrium(*target), compute_equilibrium(*fluid), strict=True)
    return {q: t + (neighbour[q] - e) for q, (t, e) in enumerate(pairs)}


class NonEquilibrium(Settings, Boundary):
    """Non-equilibrium extrapolation of Guo, Zheng & Shi 2002, eq. 6 (second order).

    f_b = f_eq(rho_b, u_b) + f_n - f_eq(rho_n, u_n), with n the inner neighbour, which also provides
    the velocity or density that is not given. With the stream's velocity it is an inlet or a far
    field, with (0, 0) a wall at rest, with a density an outflow.

    Args:
        velocity: (x, y) in units of the flow's stream speed (1 node per step by default). A
            component that is None is free, its gradient zero: (None, 0.0) is a side of a stream
            along x that makes no vorticity. An inflow must impose both, or wakes grow unstable.
        density: rho; 1.0 at an outlet fixes the pressure.
        profile: how the velocity varies along the edge.
    """

    ignores_side = True

    velocity: tuple[float | None, float | None] | None = None
    density: Annotated[float, Field(gt=0, lt=2)] | None = None
    profile: Profile = Profile.UNIFORM

    def __post_init__(self) -> None:
        if not any(value is not None for value in (*(self.velocity or ()), self.density)):
            raise ValueError("NonEquilibrium prescribes nothing: give velocity, density or both")

    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor], speed: Tensor
    ) -> dict[int, Tensor]:
        """Return all nine populations."""
        fluid = compute_macroscopic(neighbour)
        drho, ux, uy = fluid
        # what is not given is the neighbour's; 0.0 * ... gives a number the shape of the edge
        drho_b = drho if self.density is None else 0.0 * drho + (self.density - 1.0)
        ux_b, uy_b = (
            own if given is None else 0.0 * own + given * speed[..., 1:-1]
            for own, given in zip((ux, uy), self.velocity or (None, None), strict=True)
        )
        return _extrapolate(neighbour, fluid, Macroscopic(drho_b, ux_b, uy_b))


class OpenEdge(Settings, Boundary):
    """A non-reflecting edge: sound leaves, where a fixed velocity or density would reflect it.

    Non-equilibrium extrapolation with the density of an outgoing wave: rho - 1 = ((rho_n - 1) +
    (outward velocity less the stream's) / c_s) / 2 (characteristic condition in one dimension,
    Thompson 1987). Between an inlet of fixed velocity and an outflow of fixed density, sound is
    reflected back and forth as in an organ pipe and shakes bodies.

    Vortices leave with the stream: density and velocity obey d/dt + U d/dn = 0 (implicit, upwind),
    U being the stream's outward velocity, but for their means along the edge, which are those of
    the wave and of the neighbour's velocity.

    Args:
        is_plane: apply the wave condition to means along the edge, which vortices that leave do not
            change; otherwise to each node, with the velocity of the neighbour.
        velocity: (x, y) of the undisturbed stream in units of the flow's stream speed.
        profile: how that velocity varies along the edge.
    """

    is_plane: bool = True
    velocity: tuple[float, float] = (1.0, 0.0)
    profile: Profile = Profile.UNIFORM

    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor], speed: Tensor
    ) -> dict[int, Tensor]:
        """Return all nine populations."""
        nx, ny = side.value
        fluid = compute_macroscopic(neighbour)
        drho, ux, uy = fluid
        stream = speed[:, 1:-1]
        inward = nx * (ux - self.velocity[0] * stream) + ny * (uy - self.velocity[1] * stream)
        wave = 0.5 * (drho - inward * 3.0**0.5)
        if not self.is_plane:
            return _extrapolate(neighbour, fluid, Macroscopic(wave, ux, uy))
        outward = -(nx * self.velocity[0] + ny * self.velocity[1])
        own = compute_macroscopic(outgoing)  # collision has kept density and momentum
        target = []
        for plane, arriving, before in zip((wave, ux, uy), fluid, own, strict=True):
            carried = arriving
            if outward > 0.0:
                share = outward * stream
                carried = (before + share * arriving) / (1.0 + share)
            excess = (plane - carried)[:, 1:-1]  # nodes at the ends may not be complete yet
            target.append(carried + excess.mean(-1, keepdim=True))
        return _extrapolate(neighbour, fluid, Macroscopic(*target))


class NoSlip(Settings, Boundary):
    """Half-way bounce-back: a wall half a node outside the edge nodes (Ladd 1994).

    f_in = f_out(opposite) + 6 w c . U. The mass that a sliding wall carries along itself enters and
    leaves at the corners, so links through a corner belong to the wall at its end where that rests.
    Without this a lid-driven cavity converges at first order only.

    Args:
        velocity: (x, y) of the wall in units of the flow's stream speed.
    """

    is_local = True

    velocity: tuple[float, float] = (0.0, 0.0)
    profile: ClassVar[Profile] = Profile.UNIFORM  # type: ignore[misc]

    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor], speed: Tensor
    ) -> dict[int, Tensor]:
        """Return the populations that come from outside."""
        nx, ny = side.value
        inward = [q for q in range(len(CX)) if CX[q] * nx + CY[q] * ny > 0]
        edge = {}
        for q in inward:
            along = CX[q] * self.velocity[0] + CY[q] * self.velocity[1]
            back = outgoing[OPPOSITE[q]]
            shift = 1 - CX[q] * abs(ny) - CY[q] * abs(nx)  # the wall node that the link comes from
            wall = speed[:, shift : shift + back.shape[-1]]
            edge[q] = back + (6.0 * W[q] * along) * wall if along else back
        return edge


class _SetElsewhere(Boundary):
    """An edge whose populations come from elsewhere in the flow."""

    is_local = True
    velocity: ClassVar[None] = None  # type: ignore[misc]
    profile: ClassVar[Profile] = Profile.UNIFORM  # type: ignore[misc]

    def compute_edge(
        self, side: Side, neighbour: Sequence[Tensor], outgoing: Sequence[Tensor], speed: Tensor
    ) -> dict[int, Tensor]:
        """Return nothing to set."""
        return {}


class Periodic(Settings, _SetElsewhere):
    """The flow leaves on one side and enters on the other; see ``list_crossings``."""


class Filled(Settings, _SetElsewhere):
    """The edge of a patch of a finer level, which its parent fills; see ``levels.transfer``."""


class Boundaries(Settings):
    """The four edges; the default is a closed tank."""

    left: Boundary = NonEquilibrium(velocity=(0.0, 0.0))
    right: Boundary = NonEquilibrium(velocity=(0.0, 0.0))
    bottom: Boundary = NonEquilibrium(velocity=(0.0, 0.0))
    top: Boundary = NonEquilibrium(velocity=(0.0, 0.0))

    def __post_init__(self) -> None:
        for a, b in (("left", "right"), ("bottom", "top")):
            if isinstance(getattr(self, a), Periodic) != isinstance(getattr(self, b), Periodic):
                raise ValueError(f"{a} and {b} must both be Periodic or neither")

    @classmethod
    def make_stream(cls) -> "Boundaries":
        """Return the edges of a stream along +x at the flow's ``stream_speed``.

        Water moves freely along the sides, which therefore make no vorticity where the bypass of a
        body is faster than the stream. Vortices and plane sound leave at the outflow.
        """
        inflow, side = NonEquilibrium(velocity=(1.0, 0.0)), NonEquilibrium(velocity=(None, 0.0))
        return cls(left=inflow, right=OpenEdge(), bottom=side, top=side)

    def in_order(self) -> list[list[tuple[Side, Boundary]]]:
        """Return the edges in the order in which they are set; each list is independent."""
        across = [(Side.LEFT, self.left), (Side.RIGHT, self.right)]
        along = [(Side.BOTTOM, self.bottom), (Side.TOP, self.top)]
        given = [edge for edge in across + along if not isinstance(edge[1], _SetElsewhere)]
        groups = [
            [edge for edge in given if edge[1].is_local],
            [edge for edge in across if not edge[1].is_local],
            [edge for edge in along if not edge[1].is_local],
        ]
        return [group for group in groups if group]

    def evaluate_profile(self, side: Side, num_nodes: int) -> Tensor:
        """Return the profile of an edge's velocity at its nodes and corners ``[n + 2]``, float64.

        It spans the walls at the edge's two ends: half a node outside for ``NoSlip``, else on the
        end nodes.
        """
        ends = (self.bottom, self.top) if side.value[0] else (self.left, self.right)
        low, high = (0.5 if isinstance(end, NoSlip) else 0.0 for end in ends)
        nodes = torch.arange(-1, num_nodes + 1, dtype=torch.float64)
        own: Boundary = getattr(self, side.name.lower())
        values = own.profile.evaluate((nodes + low) / (num_nodes - 1.0 + low + high))
        for corner, end in zip((0, -1), ends, strict=True):
            if isinstance(end, NoSlip) and not any(end.velocity):
                values[corner] = 0.0
        return values

    def check_balance(self, width: int, height: int) -> None:
        """Raise ValueError if edges bring more water in than out, or less, and none is open."""
        inflow = 0.0
        for side in Side:
            edge, axis = getattr(self, side.name.lower()), 0 if side.value[0] else 1
            normal = (edge.velocity or (None, None))[axis]
            if isinstance(edge, Periodic):
                continue
            is_closed = isinstance(edge, NoSlip | NonEquilibrium) and normal is not None
            if not is_closed or getattr(edge, "density", None) is not None:
                return
            profile = self.evaluate_profile(side, (height, width)[axis])[1:-1]
            inflow += sum(side.value) * edge.imposed_velocity[axis] * float(profile.sum())
        if abs(inflow) > 1e-6 * (width + height):
            raise ValueError(
                f"boundaries bring {'in' if inflow > 0 else 'out'} water that nothing balances, "
                "so the density changes without end: make one of them OpenEdge()"
            )

    def list_crossings(self, height: int, width: int) -> list[tuple[int, Index, Index]]:
        """Return which outgoing populations enter on the other side of periodic edges.

        Each is (direction, index of the incoming population, index of the outgoing one), into ``[B,
        Y, X]``.
        """
        is_periodic = [isinstance(b, Periodic) for b in (self.left, self.bottom)]
        crossings = []
        for q, steps in enumerate(zip(CX, CY, strict=True)):
            spans = [
                _split_span(size, step, wraps)
                for size, step, wraps in zip((width, height), steps, is_periodic, strict=True)
            ]
            for to_x, from_x, wraps_x in spans[0]:
                for to_y, from_y, wraps_y in spans[1]:
                    if wraps_x or wraps_y:
                        every = slice(None)
                        crossings.append((q, (every, to_y, to_x), (every, from_y, from_x)))
        return crossings


def _split_span(size: int, step: int, is_periodic: bool) -> list[tuple[slice, slice, bool]]:
    """Return where nodes of one axis are reached from: (to, from, over the edge)."""
    inside = (
        slice(max(0, step), size + min(0, step)),
        slice(max(0, -step), size - max(0, step)),
        False,
    )
    if step == 0 or not is_periodic:
        return [inside]
    first, last = slice(0, 1), slice(size - 1, size)
    return [inside, (first, last, True) if step > 0 else (last, first, True)]


def apply_boundaries_(
    incoming: Sequence[Tensor],
    outgoing: Sequence[Tensor],
    boundaries: Boundaries,
    stream_speed: Tensor,
) -> None:
    """Set the edge nodes of nine ``[B, Y, X]`` ``incoming`` populations (streamed) in place.

    ``outgoing`` are populations after collision, ``stream_speed`` ``[B]`` is the present speed.
    """
    for group in boundaries.in_order():
        for side, boundary in group:
            neighbour = [f[side.neighbour] for f in incoming]
            profile = boundaries.evaluate_profile(side, neighbour[0].shape[-1])
            speed = stream_speed[:, None] * profile.to(stream_speed)
            edge = boundary.compute_edge(
                side, neighbour, [f[side.edge] for f in outgoing], speed.to(neighbour[0].dtype)
            )
            for q, values in edge.items():
                incoming[q][side.edge] = values
