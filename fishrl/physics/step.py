"""One step of the flow and the bodies in it. Read this file first.

This is the readable step: batched, functional, of any float type, differentiable. The in-place step
(``fast/grid.py``) calls the same collision, skin and edge functions and is tested against it.

The method in one paragraph. A flow is nine populations f_i at every node, the densities of fluid
that moves along the nine lattice directions c_i. ``f`` holds their deviations f_i - w_i from fluid
at rest; these sum to rho - 1, and their first moment is the momentum. A step relaxes the
populations towards equilibrium (collision), lets fluid and bodies act on each other (skin), moves
each population to the next node along its direction (streaming) and sets those that enter at the
edges. A body is a closed line of markers. In lattice units (distance of nodes and time step 1), M
takes populations to moments m, and S holds their relaxation rates (``collision.py``)::

    rho = 1 + sum_i f_i,  rho u = sum_i c_i f_i           fluid
    f' = f - M^-1 S (m - m_eq)                            collision
    f_i(x + c_i, t + 1) = f'_i(x, t)                      streaming, then the edges

**The default skin, ``BounceBack()``** (``skins/bounce_back.py``), is the line itself: populations
that meet it between two nodes return to the node they came from, with what the moving skin adds.
c_i leads from a node x outside into the body, -i is the opposite direction, q is the part of this
link that lies outside, and u_w is the velocity of the skin where the link crosses it (Bouzidi,
Firdaouss & Lallemand 2001, eqs. 5 and 11)::

    f_-i(x, t+1) = 2 q f'_i(x) + (1 - 2 q) f'_i(x - c_i) - 6 w_i rho c_i . u_w      q < 1/2
    f_-i(x, t+1) = (f'_i(x) + (2 q - 1) f'_-i(x) - 6 w_i rho c_i . u_w) / (2 q)     q >= 1/2
    F_i = c_i (f'_i + f_-i) - u_w (f'_i - f_-i)            force on the body at the link
    m_b dU/dt = sum F_i,  I_b dOmega/dt = sum r_i x F_i    rigid motion of a free body

F_i is the momentum that the link exchanges (Wen et al. 2014), r_i its arm about the centre of mass,
U the velocity there, Omega the rate of turning, m_b and I_b the body's mass and moment of inertia.
With the u_w of the last factor as it was, F_i is linear in U and Omega, so those that the flow
determines follow from at most three equations per body, with the added mass on their left side:
stable for a body as light as water. A node that the skin has left takes the skin's velocity, and
density and stresses of the next node outside. No water is lost: what reflection, covered and
uncovered nodes add to sum rho - 1 outside leaves evenly along the skin, a tenth in each step, and
the body feels the momentum of water that slipped past as its node was covered.

**The paper's skin, ``ImmersedBoundary()``** (``skins/immersed_boundary.py``; Li, Zhang et al. 2023,
arXiv 2301.10085, with its equation numbers), is a force. ds is the distance of markers along the
skin, W_l(x) the kernel of marker l at node x, A_kl = ds sum_x W_k W_l, and m_f the mass of the
fluid inside the body::

    U*_l = sum_x W_l u                            at marker l, before the force (eq. 2)
    A g = U_d - U*                                no slip: U_d is the skin's    (eq. 4)
    (m_b - m_f) dU/dt = -sum_l 2 rho g_l ds       rigid motion, with eq. 4      (eqs. 5, 6)
    F = 2 rho sum_l W_l g_l ds                    force on the fluid            (eq. 3)
    f' = f - M^-1 S (m - m_eq) + increment(F)     collision                     (eq. 1)

It differs from the paper's in two ways: force and rigid motion are solved together, and the
forcing, implicit there, is an increment after collision (``compute_force_increment``).
"""

from math import inf

import torch
from torch import Tensor

from fishrl.physics.boundaries import apply_boundaries_
from fishrl.physics.collision import Collided, collide_mrt, compute_macroscopic
from fishrl.physics.flow import FlowConfig, FlowParams, FlowState, compute_stream_speed, make_params
from fishrl.physics.levels.grids import Grids, plan_levels
from fishrl.physics.placement import check_number
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
        external_force: ``[B, 2, Y, X]`` body-force density, in addition to the bodies'; with one
            level alone.

    Returns:
        The state one step later, with levels 2^(levels - 1) steps later; the argument is unchanged.

    Raises:
        ValueError: if the state has more or fewer bodies or patches than ``config``.
    """
    check_number(config, state.bodies)
    if params is None:
        params = make_params([config] * len(state.f), state.f.device)
    num_patches = len(plan_levels(config)) - 1
    if len(state.patches) != num_patches or (num_patches and external_force is not None):
        raise ValueError(
            f"levels = {config.levels} with {len(state.patches)} patches in the state"
            f"{'' if external_force is None else ' and an external_force'}: give the state of "
            "levels.grids.make_patches, which has none with one level, and a force with one alone"
        )
    if not num_patches:
        return _step_grid(state, config, params, external_force)
    grids = Grids(state, config, params)
    grids.shift()
    _step_level(grids, 0)
    return grids.collect()


def _step_level(grids: Grids, number: int) -> None:
    """Advance a grid by one of its steps, and those inside it by two of theirs."""
    inside = grids.list_inside(number)
    for finer in inside:
        grids.fill(finer)
    level = grids.levels[number]
    grids.flows[number] = _step_grid(grids.flows[number], level.config, grids.params[number])
    for finer in inside:
        _step_level(grids, finer)
        _step_level(grids, finer)
        grids.restrict(finer)


def _step_grid(
    state: FlowState, config: FlowConfig, params: FlowParams, external_force: Tensor | None = None
) -> FlowState:
    """Advance one grid by one step."""
    f, bodies = state.f.unbind(1), state.bodies
    # the fluid, and its collision without force
    fluid = compute_macroscopic(f)
    omega = config.compute_omega(params.tau).to(fluid.drho)
    force = torch.zeros_like(state.f[:, :2]) if external_force is None else external_force
    water = Collided(collide_mrt(f, omega, config.rates), fluid, force, omega, config.rates)
    # the skin: what water and bodies do to each other, and where the bodies are then
    if bodies:
        outgoing, bodies = config.skin.exchange(water, config.bodies, params.bodies, bodies)
    else:
        outgoing = water.add_force(force)
    # streaming, and the edges at the present speed of the stream (no clock: its full speed)
    incoming = stream(outgoing)
    clock = torch.full_like(params.ramp_steps, inf) if state.clock is None else state.clock + 1.0
    apply_boundaries_(incoming, outgoing, config.boundaries, compute_stream_speed(params, clock))
    return FlowState(torch.stack(incoming, 1), bodies, clock)
