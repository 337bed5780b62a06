"""One step of the flow and its fish, as the paper writes it.

This is the readable step: batched, functional, of any float type, differentiable. The in-place step
(``in_place.py``) calls the same collision, boundaries and body functions and is tested against it.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.boundaries import apply_boundaries_
from fishrl.physics.collision import (
    collide_mrt,
    compute_equilibrium,
    compute_force_increment,
    compute_macroscopic,
)
from fishrl.physics.immersed_boundary import Stencil, couple_markers, interpolate, make_stencil
from fishrl.physics.kinematics import Deformation, Modes, deform
from fishrl.physics.rigid_motion import (
    Body,
    Coupling,
    MarkerForce,
    Markers,
    move_body,
    place_markers,
    solve_body_force,
)
from fishrl.physics.state import FlowConfig, FlowState
from fishrl.physics.streaming import stream


def step(
    state: FlowState,
    config: FlowConfig,
    modes: Modes | None = None,
    external_force: Tensor | None = None,
) -> FlowState:
    """Advance a batch of flows by one step.

    Args:
        state: populations ``[B, Q, Y, X]`` and body.
        config: of the flow.
        modes: of the fish's gait, from ``config.fish.make_modes()``; needed with a body.
        external_force: ``[B, 2, Y, X]`` body-force density, added to the fish's.

    Source: the paper's eqs. 1 to 6, with the changes listed in the theory page: force-free implicit
    coupling and the force increment of ``compute_force_increment``.
    """
    f = state.f.unbind(1)
    rho, jx, jy = compute_macroscopic(f)
    ux, uy = jx / (rho + 1.0), jy / (rho + 1.0)
    force = torch.zeros_like(state.f[:, :2]) if external_force is None else external_force
    body = state.body
    if body is not None:
        if config.fish is None or modes is None:
            raise ValueError(
                "the state has a body, but the config has no fish or modes are missing: give "
                "FlowConfig(fish=...) and modes=config.fish.make_modes()"
            )
        place = locate_body(body, config, modes, f[0].dtype)
        nodes = place.stencil.index_nodes(config.width)
        fluid = (gather(v, nodes) for v in (rho, ux, uy))
        result, share_x, share_y = exchange(body, config, place, *fluid)
        force = force + torch.stack((spread(share_x, nodes, rho), spread(share_y, nodes, rho)), 1)
        body = move_body(body, place.shape, result)
    fx, fy = force.unbind(1)
    omega = 1.0 / config.tau
    increment = compute_force_increment(rho, ux, uy, fx, fy, fx, fy, omega, config.rates)
    outgoing = [a + b for a, b in zip(collide_mrt(f, omega, config.rates), increment, strict=True)]
    incoming = stream(outgoing)
    apply_boundaries_(incoming, outgoing, config.boundaries)
    return FlowState(torch.stack(incoming, 1), body)


def make_rest(config: FlowConfig, num_envs: int, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return the populations ``[B, Q, Y, X]`` of a fluid at rest."""
    return torch.zeros(num_envs, 9, config.height, config.width, dtype=dtype)


def make_uniform(rho: Tensor, ux: Tensor, uy: Tensor) -> Tensor:
    """Return equilibrium populations ``[B, Q, Y, X]`` of ``[B, Y, X]`` fields (rho - 1, u)."""
    return torch.stack(compute_equilibrium(rho, ux, uy), 1)


class Place(NamedTuple):
    """Where the body is in this step."""

    shape: Deformation
    markers: Markers
    stencil: Stencil


def locate_body(body: Body, config: FlowConfig, modes: Modes, dtype: torch.dtype) -> Place:
    """Deform the body, place its markers and find the nodes they see."""
    shape = deform(modes, body.phase, body.frequency, body.age)
    markers = place_markers(body, modes, shape)
    stencil = make_stencil(markers.position, config.kernel, config.width, config.height, dtype)
    return Place(shape, markers, stencil)


def exchange(
    body: Body,
    config: FlowConfig,
    place: Place,
    rho: Tensor,
    ux: Tensor,
    uy: Tensor,
) -> tuple[MarkerForce, Tensor, Tensor]:
    """Solve force and rigid motion together from the fluid at the markers' nodes.

    Args:
        body: state at the start of the step.
        config: of the flow.
        place: where the body is.
        rho: density deviation at the nodes ``[B, S * S, N]``.
        ux: velocity without force along x there.
        uy: the same along y.

    Returns:
        The solve's result and each marker's share of the nodes' force density along x and y,
        ``[B, S * S, N]``: F = 2 rho W g ds.
    """
    assert config.fish is not None
    weights = place.stencil.weights
    velocity = torch.stack((interpolate(ux, weights), interpolate(uy, weights)), -1)
    spacing = config.fish.spacing
    ratio = config.fish.density_ratio
    excess = ratio if config.coupling is Coupling.EXPLICIT else ratio - 1.0
    result = solve_body_force(
        body,
        place.shape,
        place.markers,
        couple_markers(place.stencil, spacing),
        velocity,
        interpolate(rho + 1.0, weights),
        spacing=spacing,
        excess_mass=excess * config.fish.area,
        excess_inertia=excess,
        solve=config.force_solve,
        heading=config.heading,
        coupling=config.coupling,
    )
    strength = (2.0 * spacing) * (rho + 1.0) * weights
    return result, strength * result.g[:, None, :, 0], strength * result.g[:, None, :, 1]


def gather(field: Tensor, nodes: Tensor) -> Tensor:
    """Read ``field[B, Y, X]`` at flat node indices ``[B, ...]``."""
    return field.flatten(1).gather(1, nodes.flatten(1)).view_as(nodes)


def spread(shares: Tensor, nodes: Tensor, like: Tensor) -> Tensor:
    """Sum shares ``[B, S * S, N]`` at their nodes into a field shaped like ``like[B, Y, X]``."""
    field = torch.zeros_like(like).flatten(1)
    return field.scatter_add(1, nodes.flatten(1), shares.flatten(1)).view_as(like)
