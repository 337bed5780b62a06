"""Rigid motion, loads and work of a body, from the forces of a step."""

from collections.abc import Sequence

import torch
from torch import Tensor

from fishrl.physics.bodies.gait import advance_phase, compute_amplitude_rate
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.geometry import Outline, compute_axis

Pair = tuple[Tensor, Tensor]


def move_body(
    body: BodyConfig,
    params: BodyParams,
    state: BodyState,
    outline: Outline,
    rates: Sequence[Tensor],
    *,
    force: Pair,
    slip: Pair | None = None,
    felt: Tensor | None = None,
) -> BodyState:
    """Advance rigid motion, phase and totals of one body by one step.

    The water inside a body counts: the displaced mass moves with the body's velocity, so that
    hydro_force = m_f dU/dt - F. For the torque the same holds approximately (Feng & Michaelides
    2009). The external torque is what the fluid gains and the body beyond the fluid it displaces:
    zero if free.

    Args:
        body: its configuration.
        params: its parameters.
        state: its state at the start of the step.
        outline: its outline at this step.
        rates: new (U_x, U_y, Omega), ``[B]`` each.
        force: (x, y) ``[B, N]`` each, of the markers on the fluid.
        slip: (x, y) ``[B, N]`` each, remaining velocity error; None is zero.
        felt: with a sharp skin, momentum along x and y and angular momentum ``[B, 3]`` that the
            body gains in addition. ``force`` then acts on the water outside alone; totals are as if
            water filled the body and moved with it. None is with water inside, which feels it, too.
    """
    deformation, (x, y) = outline.deformation, force
    square = torch.zeros_like(x)
    if slip is not None:  # without a gradient, which would not be finite at rest
        square = (slip[0] * slip[0] + slip[1] * slip[1]).detach()
    across = deformation.lateral_velocity.to(x)
    rx, ry = (arm.to(x) for arm in outline.markers.arm.unbind(-1))
    ux, uy = outline.markers.deformation_velocity.to(x).unbind(-1)
    cos, sin = (part.to(x)[:, None] for part in compute_axis(state))
    power = x * ux + y * uy
    total = torch.stack((x.sum(-1).double(), y.sum(-1).double()), -1)
    torque = (rx * y - ry * x).sum(-1).double()
    # what the displaced fluid gains
    velocity, omega = torch.stack((rates[0], rates[1]), -1), rates[2]
    gain = params.area[:, None] * (velocity - state.velocity)
    turn = omega - state.angular_velocity
    spin_up = deformation.inertia * turn + deformation.inertia_rate * state.angular_velocity
    if felt is not None:
        total, torque = total + gain - felt[:, :2], torque + spin_up - felt[:, 2]
    external = torque + (params.density_ratio - 1.0) * spin_up
    is_still = body.motion.is_still
    return state._replace(
        position=state.position + (0.0 if is_still else velocity),
        heading=state.heading + (0.0 if is_still else omega),
        internal_angle=state.internal_angle + deformation.spin,
        velocity=velocity,
        angular_velocity=omega,
        phase=advance_phase(state.phase, state.frequency),
        beats=state.beats + state.frequency.abs(),
        age=state.age + 1.0,
        bend=state.bend + body.motion.compute_bend_rate(state),
        amplitude=state.amplitude + compute_amplitude_rate(state),
        turn_clock=state.turn_clock + 1.0,
        work=state.work + power.sum(-1).double(),
        positive_work=state.positive_work + power.clamp_min(0.0).sum(-1).double(),
        lateral_work=state.lateral_work + ((cos * y - sin * x) * across).sum(-1).double(),
        torque_work=state.torque_work + external * omega,
        torque_impulse=state.torque_impulse + torque,
        slip_error=square.amax(-1).sqrt().double(),
        force=total,
        hydro_force=gain - total,
        hydro_torque=spin_up - torque,
        impulse=state.impulse + (gain - total),
    )
