"""One step of the flow and the bodies in it, in the notation of the paper. Read this file first.

The paper is Li, Zhang et al. 2023, arXiv 2301.10085; Q = 9 is the number of directions.

This is the readable step: batched, functional, of any float type, differentiable. The in-place step
(``fast/stepper.py``) calls the same collision, boundaries and body functions and is tested against
it.

The method in one paragraph. A flow is nine populations f_i at every node, the densities of fluid
that moves along the nine lattice directions c_i. ``f`` holds their deviations f_i - w_i from fluid
at rest; these sum to rho - 1, and their first moment is the momentum. A step relaxes the
populations towards equilibrium (collision), moves each to the next node along its direction
(streaming) and sets those that enter at the edges. A body is a closed line of markers that
exchanges velocity and force with the nodes around it: the fluid velocity is interpolated to the
markers; the force that removes the slip between fluid and body, and the motion of bodies that move
freely, are solved for together; and the force is spread to the nodes. With Coupling.BOUNCE_BACK a
body reflects the populations that meet its skin instead (``bounce_back.py``).

In symbols, in lattice units (distance of nodes and time step 1), with the paper's equation numbers.
ds is the distance of markers along the skin, W_l(x) the kernel of marker l at node x, and A_kl = ds
sum_x W_k W_l. U is the velocity of a body's centre of mass, m_b its mass, and m_f that of the fluid
inside it. M takes populations to moments m, and S holds their relaxation rates (``collision.py``):

    rho = 1 + sum_i f_i,  rho u* = sum_i c_i f_i  fluid before this step's force
    U*_l = sum_x W_l u*                           at marker l, weights W_l      (eq. 2)
    A g = U_d - U*                                no slip: U_d is the skin's    (eq. 4)
    (m_b - m_f) dU/dt = -sum_l 2 rho g_l ds       rigid motion, with eq. 4      (eqs. 5, 6)
    F = 2 rho sum_l W_l g_l ds                    force on the fluid            (eq. 3)
    f' = f - M^-1 S (m - m_eq) + increment(F)     collision                     (eq. 1)
    f_i(x + c_i, t + 1) = f'_i(x, t)              streaming, then the edges
"""

from collections.abc import Sequence
from math import inf

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.bounce_back import (
    bounce_off_bodies_,
    list_slots,
    locate_skins,
    uncover_nodes_,
)
from fishrl.physics.boundaries import apply_boundaries_
from fishrl.physics.collision import (
    Macroscopic,
    collide_mrt,
    compute_force_increment,
    compute_macroscopic,
)
from fishrl.physics.coupling import solve_body_force
from fishrl.physics.flow import (
    Coupling,
    FlowConfig,
    FlowParams,
    FlowState,
    compute_stream_speed,
    make_params,
)
from fishrl.physics.geometry import BodyGeometry, locate_bodies
from fishrl.physics.immersed_boundary import interpolate
from fishrl.physics.rigid_motion import move_body
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
        config: configuration of all flows.
        params: tau, stream and bodies of each flow, where they differ from ``config`` or from each
            other; None makes them from ``config``, which with bodies is worth doing once, by
            ``make_params([config] * B)``.
        external_force: ``[B, 2, Y, X]`` body-force density, added to the bodies'.

    Returns:
        The state one step later; the argument is unchanged.

    Raises:
        ValueError: if the state has more or fewer bodies than ``config``.

    Source: the paper's eqs. 1 to 6, with two changes: force and rigid motion are solved together,
    and the forcing, implicit there, is an increment after collision (``compute_force_increment``).
    """
    if len(state.bodies) != len(config.bodies):
        raise ValueError(
            f"the state has {len(state.bodies)} bodies, the config {len(config.bodies)}: give "
            "FlowConfig(bodies=...) and FlowState(f, bodies) the same number"
        )
    if params is None:
        params = make_params([config] * len(state.f), state.f.device)
    f, bodies = state.f.unbind(1), state.bodies
    fluid = compute_macroscopic(f)
    # bodies: from the fluid at their markers to their motion and the force on the fluid
    force = torch.zeros_like(state.f[:, :2]) if external_force is None else external_force
    is_sharp = config.coupling is Coupling.BOUNCE_BACK
    if bodies and not is_sharp:
        geometry = locate_bodies(config, params.bodies, bodies, f[0].dtype)
        nodes = geometry.stencil.index_nodes(config.width)
        nearby = gather_fluid(fluid, nodes)
        bodies, share_x, share_y = couple_bodies(config, params.bodies, bodies, geometry, nearby)
        spread_x, spread_y = spread(share_x, nodes, fluid.rho), spread(share_y, nodes, fluid.rho)
        force = force + torch.stack((spread_x, spread_y), 1)
    # collision: of the fluid alone, plus what the force at each node adds to it
    omega = config.compute_omega(params.tau).to(fluid.drho)
    fx, fy = force.unbind(1)
    collided = collide_mrt(f, omega, config.rates)
    increment = compute_force_increment(fluid, (fx, fy), omega, config.rates)
    outgoing = [a + b for a, b in zip(collided, increment, strict=True)]
    if bodies and is_sharp:  # no force: in a copy, reflect what meets the skin, fill what it leaves
        kinds, own, size = config.bodies, params.bodies, (config.width, config.height)
        slots, skins = list_slots(outgoing), locate_skins(kinds, own, bodies, size)
        bodies = bounce_off_bodies_(kinds, own, bodies, skins, slots, f[0].dtype)
        moved = locate_skins(kinds, own, bodies, size, skins)
        uncover_nodes_(kinds, bodies, skins, moved, slots)
        outgoing = slots.get_nodes(outgoing[0])
    # streaming, and the edges at the present speed of the stream (no clock: its full speed)
    incoming = stream(outgoing)
    clock = torch.full_like(params.ramp_steps, inf) if state.clock is None else state.clock + 1.0
    apply_boundaries_(incoming, outgoing, config.boundaries, compute_stream_speed(params, clock))
    return FlowState(torch.stack(incoming, 1), bodies, clock)


def couple_bodies(
    config: FlowConfig,
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    geometry: BodyGeometry,
    fluid: Macroscopic,
) -> tuple[tuple[BodyState, ...], Tensor, Tensor]:
    """Solve for the force between fluid and bodies and for the bodies' motion, together.

    ``fluid`` is given at the S x S nodes around each of the N markers, ``[B, S * S, N]``.

    Returns:
        The bodies after the step and each marker's share of the nodes' force density along x and y,
        ``[B, S * S, N]``: F = 2 rho W g ds, with g from ``solve_body_force``.
    """
    weights = geometry.stencil.weights
    velocity = torch.stack((interpolate(fluid.ux, weights), interpolate(fluid.uy, weights)), 1)
    rho = interpolate(fluid.rho, weights)
    g, updates = solve_body_force(config, params, states, geometry, velocity, rho)
    bodies = zip(
        config.bodies, params, states, geometry.outlines.deformations, updates, strict=True
    )
    moved = tuple(
        move_body(body, body_params, state, deformation, update)
        for body, body_params, state, deformation, update in bodies
    )
    strength = 2.0 * geometry.spacing[:, None] * fluid.rho * weights
    return moved, strength * g[:, None, 0], strength * g[:, None, 1]


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
