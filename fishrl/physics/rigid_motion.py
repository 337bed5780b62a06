"""Rigid motion, loads and work of a body, from the forces of a step."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.gait import Deformation, advance_phase, compute_amplitude_rate
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.geometry import Outline, compute_axis

Pair = tuple[Tensor, Tensor]


class RigidUpdate(NamedTuple):
    """Result of one coupled solve for one body."""

    velocity: Tensor  #: ``[B, 2]`` new velocity of the centre of mass
    angular_velocity: Tensor  #: ``[B]`` new Omega
    slip_error: Tensor  #: ``[B]`` largest remaining velocity error at a marker
    force: Tensor  #: ``[B, 2]`` total force on the fluid
    torque: Tensor  #: ``[B]`` total torque on the fluid
    power: Tensor  #: ``[B]`` sum of F . u_def
    positive_power: Tensor  #: ``[B]`` the same over those markers where it is positive
    lateral_power: Tensor  #: ``[B]`` its part along the body's own lateral axis, without -H/I


def report_body(
    state: BodyState,
    outline: Outline,
    rates: Sequence[Tensor],
    *,
    force: Pair,
    slip: Pair | None,
) -> RigidUpdate:
    """Return new velocities, force, torque and power of a body from the solution of a step.

    Args:
        state: state of the body at the start of the step.
        outline: its outline at this step.
        rates: new (U_x, U_y, Omega), ``[B]`` each.
        force: (x, y) ``[B, N]`` each, of the markers on the fluid.
        slip: (x, y) ``[B, N]`` each, remaining velocity error; None is zero.
    """
    x, y = force
    square = torch.zeros_like(x)
    if slip is not None:  # without a gradient, which would not be finite at rest
        square = (slip[0] * slip[0] + slip[1] * slip[1]).detach()
    across = outline.deformation.lateral_velocity.to(x)
    rx, ry = (arm.to(x) for arm in outline.markers.arm.unbind(-1))
    ux, uy = outline.markers.deformation_velocity.to(x).unbind(-1)
    cos, sin = (part.to(x)[:, None] for part in compute_axis(state))
    power = x * ux + y * uy
    return RigidUpdate(
        velocity=torch.stack((rates[0], rates[1]), -1),
        angular_velocity=rates[2],
        slip_error=square.amax(-1).sqrt().double(),
        force=torch.stack((x.sum(-1).double(), y.sum(-1).double()), -1),
        torque=(rx * y - ry * x).sum(-1).double(),
        power=power.sum(-1).double(),
        positive_power=power.clamp_min(0.0).sum(-1).double(),
        lateral_power=((cos * y - sin * x) * across).sum(-1).double(),
    )


def measure_gain(
    params: BodyParams, state: BodyState, deformation: Deformation, update: RigidUpdate
) -> Pair:
    """Return what the displaced fluid gains: momentum ``[B, 2]``, angular momentum ``[B]``."""
    turn = update.angular_velocity - state.angular_velocity
    spin_up = deformation.inertia * turn + deformation.inertia_rate * state.angular_velocity
    return params.area[:, None] * (update.velocity - state.velocity), spin_up


def move_body(
    config: BodyConfig,
    params: BodyParams,
    state: BodyState,
    deformation: Deformation,
    update: RigidUpdate,
) -> BodyState:
    """Advance rigid motion, phase and totals of one body by one step.

    The markers' force also drives the fluid inside the body, whose momentum is exactly the
    displaced mass times the body's velocity: hydro_force = m_f dU/dt - F. For the torque the same
    holds approximately (Feng & Michaelides 2009). The external torque is what the fluid gains and
    the body beyond the fluid it displaces: zero if free.
    """
    gain, spin_up = measure_gain(params, state, deformation, update)
    hydro_force = gain - update.force
    torque = update.torque + (params.density_ratio - 1.0) * spin_up
    is_still = config.motion.is_still
    return state._replace(
        position=state.position + (0.0 if is_still else update.velocity),
        heading=state.heading + (0.0 if is_still else update.angular_velocity),
        internal_angle=state.internal_angle + deformation.spin,
        velocity=update.velocity,
        angular_velocity=update.angular_velocity,
        phase=advance_phase(state.phase, state.frequency),
        beats=state.beats + state.frequency.abs(),
        age=state.age + 1.0,
        bend=state.bend + config.motion.compute_bend_rate(state),
        amplitude=state.amplitude + compute_amplitude_rate(state),
        turn_clock=state.turn_clock + 1.0,
        work=state.work + update.power,
        positive_work=state.positive_work + update.positive_power,
        lateral_work=state.lateral_work + update.lateral_power,
        torque_work=state.torque_work + torque * update.angular_velocity,
        torque_impulse=state.torque_impulse + update.torque,
        slip_error=update.slip_error,
        force=update.force,
        hydro_force=hydro_force,
        hydro_torque=spin_up - update.torque,
        impulse=state.impulse + hydro_force,
    )
