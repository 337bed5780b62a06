"""Immersed boundary: markers and nodes exchange velocity and force through a delta kernel.

With weights W_l(x) of marker l and spacing ds, interpolation is U_l = sum_x W_l u and the force
2 rho W_l g_l ds at the nodes adds the velocity A g at the markers, A_kl = ds sum_x W_k W_l. No slip
means A g = U_d - U*. The solve works on the marker side: A is a small dense matrix, and iterating
needs no pass over the grid.

Marker l sits at x_l = X + R(angle) (axial, lateral) and moves with V_l = U + (Omega - H/I) z x
r_l + R u_deform. Fluid and bodies are solved together: with the force solve written as a linear map
P, g = P (U_d - U*) is linear in every body's (U, Omega), so the new rigid velocities follow from
one small system and the momentum that a body gains is exactly what the fluid loses. At equal
density the body's mass cancels against the fluid inside it and the skin is force-free; with the
force of the last step, as the paper writes it, the motion is unstable there (added mass).
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.collision import Collided, Macroscopic
from fishrl.physics.geometry import Outline, locate_outline
from fishrl.physics.rigid_motion import move_body
from fishrl.physics.skins.delta import SUPPORT, Stencil, interpolate, make_stencil, overlap_markers
from fishrl.physics.skins.force_solve import ForceSolve, IterativeForcing
from fishrl.physics.skins.skin import Skin
from fishrl.physics.surface import Freedom, eliminate, prescribe_surface


class ImmersedBoundary(Skin):
    """The paper's skin: a force at the markers, spread over three nodes, that removes the slip.

    The water on both sides of a thin fish feels each other's skin, which slows it on coarse grids.

    Args:
        force_solve: method that enforces no slip.
    """

    marker_spacing: ClassVar[float] = 1.0
    spacing_range: ClassVar[tuple[float, float]] = (0.4, 2.1)
    margin: ClassVar[float] = 0.5 * SUPPORT - 1.0
    jumps: ClassVar[bool] = False
    has_water_inside: ClassVar[bool] = True

    force_solve: ForceSolve = IterativeForcing()

    def exchange(
        self,
        water: Collided,
        bodies: Sequence[BodyConfig],
        params: Sequence[BodyParams],
        states: Sequence[BodyState],
    ) -> tuple[list[Tensor], tuple[BodyState, ...]]:
        """Read the fluid at the markers, solve for force and motion, spread the force."""
        height, width = water.f[0].shape[-2:]
        size = width, height
        geometry = locate_bodies(self, bodies, params, states, size, water.f[0].dtype)
        nodes = geometry.stencil.index_nodes(width)
        nearby = gather_fluid(water.fluid, nodes)
        moved, share_x, share_y = couple_bodies(self, bodies, params, states, geometry, nearby)
        rho = water.fluid.rho
        spread_x, spread_y = spread(share_x, nodes, rho), spread(share_y, nodes, rho)
        return water.add_force(water.force + torch.stack((spread_x, spread_y), 1)), moved

    def choose_inset(self, body: BodyConfig) -> float:
        """Return 0.45 for a thick body, since a force spread over nodes makes it that much larger.

        Three-point kernel, measured on a cylinder, see the validation page; the idea is Breugem's
        (2012). A slender body has its markers on the outline.
        """
        return 0.0 if body.is_slender else 0.45

    def find_least_density(self, body: BodyConfig) -> float:
        """Return a density at which half a node of water along the outline outweighs the lack.

        See "Motion" in the documentation's theory for the measurements.
        """
        return max(0.0, 1.0 - 0.5 * body.spacing * body.num_markers / body.area)


class BodyGeometry(NamedTuple):
    """All bodies in one step; the markers of the bodies follow each other in N."""

    outlines: tuple[Outline, ...]  #: how each body deforms and where its markers are
    spacing: Tensor  #: ``[B, N]`` length of outline that each marker represents
    stencil: Stencil  #: nodes around all markers
    operator: tuple[Tensor, ...]  #: what the force solve needs, from ``ForceSolve.prepare``


def locate_bodies(
    skin: ImmersedBoundary,
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    size: tuple[int, int],
    dtype: torch.dtype,
) -> BodyGeometry:
    """Deform the bodies, place their markers, find the nodes around them; weights of ``dtype``.

    The grid has a ``size`` of (width, height) nodes.
    """
    each = zip(bodies, params, states, strict=True)
    outlines = tuple(locate_outline(*body) for body in each)
    positions = torch.cat([outline.markers.position for outline in outlines], 1)
    stencil = make_stencil(positions, *size, dtype)
    spacing = torch.cat([p.spacing.to(dtype).expand(len(positions), -1) for p in params], -1)
    operator = skin.force_solve.prepare(overlap_markers(stencil), spacing)
    return BodyGeometry(outlines, spacing, stencil, operator)


def couple_bodies(
    skin: ImmersedBoundary,
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    geometry: BodyGeometry,
    fluid: Macroscopic,
) -> tuple[tuple[BodyState, ...], Tensor, Tensor]:
    """Solve for the force between fluid and bodies and for the bodies' motion, together.

    ``fluid`` is given at the S x S nodes around each of the N markers, ``[B, S * S, N]``.

    Returns:
        The bodies after the step and each marker's share of the nodes' force density along x and y,
        ``[B, S * S, N]``: F = 2 rho W g ds.
    """
    weights, dtype = geometry.stencil.weights, fluid.ux.dtype
    water = interpolate(fluid.ux, weights), interpolate(fluid.uy, weights)
    mass = 2.0 * interpolate(fluid.rho, weights) * geometry.spacing  # F = mass g
    own, surfaces = _slice_markers(geometry.outlines), []
    for m, outline in enumerate(geometry.outlines):
        one = bodies[m], params[m], states[m], outline, dtype
        surfaces.append(prescribe_surface(*one, has_water_inside=True))
    freedoms = [(m, free) for m, surface in enumerate(surfaces) for free in surface.freedoms]
    # The force that removes the slip, and the one that a unit of each freedom causes: a right-hand
    # side for each velocity, at all markers, that two freedoms may share (x and y).
    velocity = torch.cat([surface.velocity for surface in surfaces], -1)
    units: dict[int, Tensor] = {}
    for m, free in freedoms:
        before_after = own[m].start, own[-1].stop - own[m].stop
        units |= {id(unit): pad(unit, before_after) for unit in free.unit if unit is not None}
    row = {key: 2 + number for number, key in enumerate(units)}
    residual = velocity - torch.stack(water, 1)
    right = torch.stack([*residual.unbind(1), *units.values()], 1)
    solution, rest = skin.force_solve(geometry.operator, right)

    def respond(free: Freedom, rows: Tensor) -> list[Tensor | None]:
        """Return the rows (x, y) of ``[B, R, N]`` that a unit of a freedom causes."""
        return [None if unit is None else rows[:, row[id(unit)]] for unit in free.unit]

    def project(m: int, free: Freedom, g: Sequence[Tensor | None]) -> Tensor | float:
        """Return the force or torque ``[B]`` along a freedom of body m that g puts on the fluid."""
        pairs = zip(free.unit, g, strict=True)
        parts = [u * v[:, own[m]] for u, v in pairs if u is not None and v is not None]
        if not parts:
            return 0.0
        return (mass[:, own[m]] * sum(parts[1:], parts[0])).sum(-1).double()

    # Newton's second law: (inertia + added mass) dU = -F + push. The added mass is the force that
    # dU itself causes.
    matrix = [
        [project(m, i, respond(j, solution)) + (i.inertia if i is j else 0.0) for _, j in freedoms]
        for m, i in freedoms
    ]
    g, slip = [*solution[:, :2].unbind(1)], [*rest[:, :2].unbind(1)]
    changes = eliminate(matrix, [-project(m, free, g) + free.push for m, free in freedoms])
    for (_, free), change in zip(freedoms, changes, strict=True):
        weight = change.to(dtype)[:, None]
        for values, rows in ((g, solution), (slip, rest)):
            for axis, response in enumerate(respond(free, rows)):
                if response is not None:
                    values[axis] = values[axis] + weight * response
    moved = []
    for m, (body, surface, at) in enumerate(zip(bodies, surfaces, own, strict=True)):
        rates = list(surface.rates)
        for (k, free), change in zip(freedoms, changes, strict=True):
            if k == m:
                rates[free.axis] = rates[free.axis] + change
        after = move_body(
            body,
            params[m],
            states[m],
            geometry.outlines[m],
            rates,
            force=((mass * g[0])[:, at], (mass * g[1])[:, at]),
            slip=(slip[0][:, at], slip[1][:, at]),
        )
        moved.append(after)
    strength = 2.0 * geometry.spacing[:, None] * fluid.rho * weights
    return tuple(moved), strength * g[0][:, None], strength * g[1][:, None]


def _slice_markers(outlines: Sequence[Outline]) -> list[slice]:
    """Return where the markers of each body are among all."""
    numbers = [outline.markers.position.shape[1] for outline in outlines]
    return [slice(end - n, end) for end, n in zip(accumulate(numbers), numbers, strict=True)]


def gather_fluid(fluid: Macroscopic, nodes: Tensor) -> Macroscopic:
    """Read the fields ``[B, Y, X]`` at flat node indices ``[B, ...]``."""
    drho, ux, uy = fluid
    return Macroscopic(gather(drho, nodes), gather(ux, nodes), gather(uy, nodes))


def gather(field: Tensor, nodes: Tensor) -> Tensor:
    """Read ``field[B, Y, X]`` at flat node indices ``[B, ...]``."""
    return field.flatten(1).gather(1, nodes.flatten(1)).view_as(nodes)


def spread(shares: Tensor, nodes: Tensor, like: Tensor) -> Tensor:
    """Sum shares ``[B, S * S, N]`` at their nodes into a field shaped like ``like[B, Y, X]``."""
    field = torch.zeros_like(like).flatten(1)
    return field.scatter_add(1, nodes.flatten(1), shares.flatten(1)).view_as(like)
