"""One step of the flow and the bodies in it, as the paper writes it.

This is the readable step: batched, functional, of any float type, differentiable. The in-place step
(``in_place.py``) calls the same collision, boundaries and body functions and is tested against it.
"""

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.coupling import (
    Markers,
    deform_body,
    move_body,
    place_markers,
    solve_body_force,
)
from fishrl.physics.bodies.gait import Deformation
from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.boundaries import apply_boundaries_
from fishrl.physics.collision import (
    collide_mrt,
    compute_equilibrium,
    compute_force_increment,
    compute_macroscopic,
)
from fishrl.physics.flow import (
    FlowConfig,
    FlowParams,
    FlowState,
    compute_stream_speed,
    make_params,
)
from fishrl.physics.immersed_boundary import (
    Stencil,
    interpolate,
    make_stencil,
    overlap_markers,
)
from fishrl.physics.streaming import stream


def step(
    state: FlowState,
    config: FlowConfig,
    params: FlowParams | None = None,
    external_force: Tensor | None = None,
) -> FlowState:
    """Advance a batch of flows by one step.

    Args:
        state: populations ``[B, Q, Y, X]`` and bodies.
        config: of the flows.
        params: what differs between them, from ``make_params``; None makes those of ``config``,
            which takes long where there are bodies.
        external_force: ``[B, 2, Y, X]`` body-force density, added to the bodies'.

    Source: the paper's eqs. 1 to 6, with the changes listed in the theory page: force-free implicit
    coupling and the force increment of ``compute_force_increment``.
    """
    if len(state.bodies) != len(config.bodies):
        raise ValueError(
            f"the state has {len(state.bodies)} bodies, the config {len(config.bodies)}: give "
            "FlowConfig(bodies=...) and FlowState(f, bodies) the same number"
        )
    params = make_params([config]) if params is None else params
    f = state.f.unbind(1)
    rho, jx, jy = compute_macroscopic(f)
    ux, uy = jx / (rho + 1.0), jy / (rho + 1.0)
    force = torch.zeros_like(state.f[:, :2]) if external_force is None else external_force
    bodies = state.bodies
    if bodies:
        place = locate_bodies(bodies, config, params.bodies, f[0].dtype)
        nodes = place.stencil.index_nodes(config.width)
        fluid = (gather(v, nodes) for v in (rho, ux, uy))
        bodies, share_x, share_y = exchange(bodies, config, params.bodies, place, *fluid)
        force = force + torch.stack((spread(share_x, nodes, rho), spread(share_y, nodes, rho)), 1)
    fx, fy = force.unbind(1)
    omega = config.compute_omega(params.tau).to(rho)
    increment = compute_force_increment(rho, ux, uy, fx, fy, fx, fy, omega, config.rates)
    outgoing = [a + b for a, b in zip(collide_mrt(f, omega, config.rates), increment, strict=True)]
    incoming = stream(outgoing)
    clock = torch.full_like(params.ramp_steps, inf) if state.clock is None else state.clock + 1.0
    apply_boundaries_(incoming, outgoing, config.boundaries, compute_stream_speed(params, clock))
    return FlowState(torch.stack(incoming, 1), bodies, clock)


def make_rest(config: FlowConfig, num_envs: int, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return the populations ``[B, Q, Y, X]`` of a fluid at rest."""
    return torch.zeros(num_envs, 9, config.height, config.width, dtype=dtype)


def make_uniform(rho: Tensor, ux: Tensor, uy: Tensor) -> Tensor:
    """Return equilibrium populations ``[B, Q, Y, X]`` of ``[B, Y, X]`` fields (rho - 1, u)."""
    return torch.stack(compute_equilibrium(rho, ux, uy), 1)


class BodyGeometry(NamedTuple):
    """Where the bodies are in this step.

    Attributes:
        deformations: of each body.
        markers: of each body.
        stencil: of all markers.
        operator: of the force solve.
    """

    deformations: tuple[Deformation, ...]
    markers: tuple[Markers, ...]
    stencil: Stencil
    operator: tuple[Tensor, ...]


def locate_bodies(
    bodies: Sequence[BodyState],
    config: FlowConfig,
    shapes: Sequence[BodyParams],
    dtype: torch.dtype,
) -> BodyGeometry:
    """Deform the bodies, place their markers and find the nodes they see."""
    triples = zip(config.bodies, shapes, bodies, strict=True)
    deformations = tuple(deform_body(outline, shape, body) for outline, shape, body in triples)
    markers = tuple(place_markers(b, d) for b, d in zip(bodies, deformations, strict=True))
    positions = torch.cat([m.position for m in markers], 1)
    stencil = make_stencil(positions, config.kernel, config.width, config.height, dtype)
    spacing = torch.cat([s.spacing.to(dtype).expand(len(positions), -1) for s in shapes], -1)
    operator = config.force_solve.prepare(overlap_markers(stencil), spacing)
    return BodyGeometry(deformations, markers, stencil, operator)


def exchange(
    bodies: Sequence[BodyState],
    config: FlowConfig,
    shapes: Sequence[BodyParams],
    place: BodyGeometry,
    rho: Tensor,
    ux: Tensor,
    uy: Tensor,
) -> tuple[tuple[BodyState, ...], Tensor, Tensor]:
    """Solve force and rigid motion together from the fluid at the markers' nodes.

    Args:
        bodies: states at the start of the step.
        config: of the flows.
        shapes: of the bodies.
        place: where the bodies are.
        rho: density deviation at the nodes ``[B, S * S, N]``.
        ux: velocity without force along x there.
        uy: the same along y.

    Returns:
        The bodies after the step and each marker's share of the nodes' force density along x and y,
        ``[B, S * S, N]``: F = 2 rho W g ds.
    """
    weights = place.stencil.weights
    g, updates = solve_body_force(
        config.bodies,
        shapes,
        bodies,
        place.deformations,
        place.markers,
        place.operator,
        torch.stack((interpolate(ux, weights), interpolate(uy, weights)), 1),
        interpolate(rho + 1.0, weights),
        solve=config.force_solve,
        coupling=config.coupling,
    )
    moved = tuple(
        move_body(*each)
        for each in zip(config.bodies, shapes, bodies, place.deformations, updates, strict=True)
    )
    spacing = torch.cat([s.spacing.to(ux.dtype).expand(len(ux), -1) for s in shapes], -1)
    strength = 2.0 * spacing[:, None] * (rho + 1.0) * weights
    return moved, strength * g[:, None, 0], strength * g[:, None, 1]


def gather(field: Tensor, nodes: Tensor) -> Tensor:
    """Read ``field[B, Y, X]`` at flat node indices ``[B, ...]``."""
    return field.flatten(1).gather(1, nodes.flatten(1)).view_as(nodes)


def spread(shares: Tensor, nodes: Tensor, like: Tensor) -> Tensor:
    """Sum shares ``[B, S * S, N]`` at their nodes into a field shaped like ``like[B, Y, X]``."""
    field = torch.zeros_like(like).flatten(1)
    return field.scatter_add(1, nodes.flatten(1), shares.flatten(1)).view_as(like)
