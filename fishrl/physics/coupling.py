"""Coupling of the bodies' rigid motion to the flow.

Marker l sits at x_l = X + R(angle) (axial, lateral) and moves with V_l = U + (Omega - H/I) z x
r_l + R u_deform. Fluid and bodies are solved together: with the force solve written as a linear map
P, g = P (U_d - U*) is linear in every body's (U, Omega), so the new rigid velocities follow from
one small system and the momentum that a body gains is exactly what the fluid loses. At equal
density the body's mass cancels against the fluid inside it and the skin is force-free; explicit
coupling, as the paper writes it, is unstable there (added mass).
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from fishrl.physics.bodies.gait import Deformation, advance_phase
from fishrl.physics.bodies.motion import compute_amplitude_rate
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.flow import Coupling, FlowConfig
from fishrl.physics.geometry import BodyGeometry, Markers, compute_axis

_Pair = tuple[Tensor | None, Tensor | None]


class RigidUpdate(NamedTuple):
    """What one coupled solve gives for one body.

    Attributes:
        velocity: ``[B, 2]`` new velocity of the centre of mass.
        angular_velocity: ``[B]`` new Omega.
        slip_error: ``[B]`` largest remaining velocity error at a marker.
        force: ``[B, 2]`` total force on the fluid.
        torque: ``[B]`` total torque on the fluid.
        power: ``[B]`` sum of F . u_def.
        positive_power: ``[B]`` the same over those markers where it is positive.
        lateral_power: ``[B]`` its part along the body's own lateral axis, without -H/I.
    """

    velocity: Tensor
    angular_velocity: Tensor
    slip_error: Tensor
    force: Tensor
    torque: Tensor
    power: Tensor
    positive_power: Tensor
    lateral_power: Tensor


class Freedom(NamedTuple):
    """One rigid degree of freedom that the flow determines.

    Attributes:
        body: index of its body.
        axis: 0 and 1 for the centre of mass along x and y, 2 for turning.
        unit: velocity (x, y) that a unit of it gives all markers, ``[B, N]``; None is zero.
        rows: of the force solve whose right-hand sides these are.
        inertia: ``[B]`` mass or moment of inertia; implicit coupling leaves out the fluid's inside.
        push: ``[B]`` force or torque beside the fluid's.
    """

    body: int
    axis: int
    unit: _Pair
    rows: tuple[int | None, int | None]
    inertia: Tensor
    push: Tensor

    def respond(self, solution: Tensor) -> _Pair:
        """Return the rows (x, y) of a solution ``[B, R, N]`` that a unit of it causes."""
        x, y = self.rows
        return None if x is None else solution[:, x], None if y is None else solution[:, y]


class Surface(NamedTuple):
    """How the bodies' surface moves if the flow changes no rate, and the rates that it may change.

    Attributes:
        rates: (U_x, U_y, Omega) ``[B]`` of each body: prescribed, or as in the last step.
        velocity: ``[B, 2, N]`` of the markers at these rates.
        freedoms: rates that the flow determines.
        units: ``[B, N]`` right-hand sides of the force solve for the freedoms.
    """

    rates: list[list[Tensor]]
    velocity: Tensor
    freedoms: list[Freedom]
    units: list[Tensor]


class _MarkerMass(NamedTuple):
    """Fluid mass that the markers' forces act on: F = mass g at each marker.

    Attributes:
        mass: ``[B, N]``, 2 rho ds.
        own: slice of each body's markers.
    """

    mass: Tensor
    own: list[slice]

    def project(self, freedom: Freedom, g: _Pair) -> Tensor | float:
        """Return the force or torque ``[B]`` along a degree of freedom that g puts on the fluid."""
        pairs = zip(freedom.unit, g, strict=True)
        parts = [unit * value for unit, value in pairs if unit is not None and value is not None]
        if not parts:
            return 0.0
        work = self.mass * sum(parts[1:], parts[0])
        return work[:, self.own[freedom.body]].sum(-1).double()


def solve_body_force(
    config: FlowConfig,
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    geometry: BodyGeometry,
    velocity: Tensor,
    rho: Tensor,
) -> tuple[Tensor, list[RigidUpdate]]:
    """Find the marker force and the new rigid velocities of all bodies together.

    Args:
        config: of the flows; ``force_solve`` is P. Explicit coupling is the paper's with corrected
            sign: the body feels minus the force on the fluid.
        params: of each body.
        states: of each body at the start of the step.
        geometry: of the bodies at this step.
        velocity: ``[B, 2, N]`` unforced fluid velocity at the markers.
        rho: ``[B, N]`` fluid density at the markers.

    Returns:
        g ``[B, 2, N]``, with F = 2 rho g per unit length, and an update per body.
    """
    markers = _MarkerMass(2.0 * rho * geometry.spacing, _slice_markers(config.bodies))
    surface = prescribe_surface(config, params, states, geometry, velocity.dtype)
    residual = surface.velocity - velocity
    right = torch.stack([*residual.unbind(1), *surface.units], 1)
    solution, rest = config.force_solve(geometry.operator, right)
    is_implicit = config.coupling is Coupling.IMPLICIT
    changes = _solve_rigid_motion(surface.freedoms, markers, solution, is_implicit)
    g, slip = list(solution[:, :2].unbind(1)), list(rest[:, :2].unbind(1))
    if is_implicit:
        for freedom, change in zip(surface.freedoms, changes, strict=True):
            weight = change.to(velocity.dtype)[:, None]
            for values, rows in ((g, solution), (slip, rest)):
                for axis, response in enumerate(freedom.respond(rows)):
                    if response is not None:
                        values[axis] = values[axis] + weight * response
    updates = report_bodies(
        config, states, geometry, surface, changes=changes, mass=markers.mass, g=g, slip=slip
    )
    return torch.stack(g, 1), updates


def report_bodies(
    config: FlowConfig,
    states: Sequence[BodyState],
    geometry: BodyGeometry,
    surface: Surface,
    *,
    changes: Sequence[Tensor],
    mass: Tensor,
    g: Sequence[Tensor],
    slip: Sequence[Tensor],
) -> list[RigidUpdate]:
    """Return what the solution of a step means for each body.

    ``changes`` ``[B]`` are those of the rates that the flow determines; at all markers, ``[B, N]``
    each, ``mass`` is that of the fluid, ``g`` (x, y) the force per mass and ``slip`` (x, y) the
    remaining velocity error. The other arguments are those of ``solve_body_force``.
    """
    rates = [list(own) for own in surface.rates]
    for freedom, change in zip(surface.freedoms, changes, strict=True):
        own_rates = rates[freedom.body]
        own_rates[freedom.axis] = own_rates[freedom.axis] + change
    square = slip[0] * slip[0] + slip[1] * slip[1]
    return [
        _report(
            states[m],
            geometry.markers[m],
            rates=rates[m],
            lateral_velocity=geometry.deformations[m].lateral_velocity,
            mass=mass[:, own],
            g=(g[0][:, own], g[1][:, own]),
            square=square[:, own],
        )
        for m, own in enumerate(_slice_markers(config.bodies))
    ]


def _slice_markers(bodies: Sequence[BodyConfig]) -> list[slice]:
    """Return where the markers of each body are among all."""
    ends = list(accumulate(body.num_markers for body in bodies))
    return [slice(end - body.num_markers, end) for end, body in zip(ends, bodies, strict=True)]


def prescribe_surface(
    config: FlowConfig,
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    geometry: BodyGeometry,
    dtype: torch.dtype,
) -> Surface:
    """Return the motion of all markers with the rates prescribed, or as in the last step."""
    own, num_markers = _slice_markers(config.bodies), geometry.spacing.shape[-1]
    displaced = 1.0 if config.coupling is Coupling.IMPLICIT else 0.0

    def widen(values: Tensor, m: int) -> Tensor:
        """Return values of body m at all markers, zero at those of the others."""
        return pad(values, (own[m].start, num_markers - own[m].stop)) if len(own) > 1 else values

    rates: list[list[Tensor]] = []
    velocities: list[Tensor] = []
    freedoms: list[Freedom] = []
    units: list[Tensor] = []
    for m, (body, state) in enumerate(zip(config.bodies, states, strict=True)):
        markers, deformation, motion = geometry.markers[m], geometry.deformations[m], body.motion
        linear, omega = motion.prescribe(state)
        own_rates = [*linear.unbind(-1), omega]
        last = *state.velocity.unbind(-1), state.angular_velocity
        for axis in motion.free_axes:
            own_rates[axis] = last[axis]
        rates.append(own_rates)
        linear, omega = torch.stack(own_rates[:2], -1), own_rates[2]
        spin = torch.stack((-markers.arm[..., 1], markers.arm[..., 0]), -1) * omega[:, None, None]
        velocities.append((linear[:, None] + spin + markers.deformation_velocity).to(dtype).mT)
        rx, ry = (arm.to(dtype) for arm in markers.arm.unbind(-1))
        excess = params[m].density_ratio - displaced
        row = 2 + len(units)  # the first two rows are the slip itself
        shifts = [axis for axis in motion.free_axes if axis < 2]
        if shifts:
            one, mass = widen(torch.ones_like(rx), m), excess * params[m].area
            units.append(one)
            for axis in shifts:
                unit, rows = ((one, None), (row, None)) if axis == 0 else ((None, one), (None, row))
                freedoms.append(Freedom(m, axis, unit, rows, mass, state.load[:, axis]))
            row += 1
        if 2 in motion.free_axes:
            turning = widen(-ry, m), widen(rx, m)
            units += turning
            inertia = excess * deformation.inertia
            push = -(excess * deformation.inertia_rate * state.angular_velocity)
            freedoms.append(Freedom(m, 2, turning, (row, row + 1), inertia, push))
    return Surface(rates, torch.cat(velocities, -1), freedoms, units)


def _solve_rigid_motion(
    freedoms: Sequence[Freedom], markers: _MarkerMass, solution: Tensor, is_implicit: bool
) -> list[Tensor]:
    """Return the change ``[B]`` of each rate that the flow determines, by Newton's second law.

    Implicit: (inertia + added mass) dU = -F + push. The added mass is the force that dU itself
    causes, the projection of the other rows of the force solve. Explicit: without it.
    """
    slip_force = solution[:, 0], solution[:, 1]
    matrix, drive = [], []
    for i in freedoms:
        row = [
            (markers.project(i, j.respond(solution)) if is_implicit else 0.0)
            + (i.inertia if i is j else 0.0)
            for j in freedoms
        ]
        matrix.append(row)
        drive.append(-markers.project(i, slip_force) + i.push)
    return eliminate(matrix, drive)


def _report(
    state: BodyState,
    markers: Markers,
    *,
    rates: Sequence[Tensor],
    lateral_velocity: Tensor,
    mass: Tensor,
    g: tuple[Tensor, Tensor],
    square: Tensor,
) -> RigidUpdate:
    """Sum force, torque and power over the markers of one body.

    ``rates`` are its new (U_x, U_y, Omega). At its markers, ``[B, N]`` each: ``lateral_velocity``
    of its deformation in its own frame, fluid ``mass``, force per mass ``g`` and ``square`` of the
    remaining slip.
    """
    dtype = square.dtype
    rx, ry = (arm.to(dtype) for arm in markers.arm.unbind(-1))
    ux, uy = markers.deformation_velocity.to(dtype).unbind(-1)
    cos, sin = (part.to(dtype)[:, None] for part in compute_axis(state))
    across = lateral_velocity.to(dtype)
    fx, fy = mass * g[0], mass * g[1]
    power = fx * ux + fy * uy
    return RigidUpdate(
        velocity=torch.stack((rates[0], rates[1]), -1),
        angular_velocity=rates[2],
        slip_error=square.amax(-1).sqrt().double(),
        force=torch.stack((fx.sum(-1).double(), fy.sum(-1).double()), -1),
        torque=(rx * fy - ry * fx).sum(-1).double(),
        power=power.sum(-1).double(),
        positive_power=power.clamp_min(0.0).sum(-1).double(),
        lateral_power=((cos * fy - sin * fx) * across).sum(-1).double(),
    )


def eliminate(matrix: Sequence[Sequence[Tensor | float]], right: Sequence[Tensor]) -> list[Tensor]:
    """Solve a small system of ``[B]`` tensors; plain zeros in ``matrix`` cost nothing.

    Elimination without pivoting: the matrix is added mass plus excess mass, positive definite.
    """
    rows, values = [list(row) for row in matrix], list(right)
    size = len(values)
    for k in range(size):
        for i in range(k + 1, size):
            if not _is_zero(rows[i][k]):
                factor = rows[i][k] / rows[k][k]
                for j in range(k + 1, size):
                    if not _is_zero(rows[k][j]):
                        rows[i][j] = rows[i][j] - factor * rows[k][j]
                values[i] = values[i] - factor * values[k]
    for i in reversed(range(size)):
        for j in range(i + 1, size):
            if not _is_zero(rows[i][j]):
                values[i] = values[i] - rows[i][j] * values[j]
        values[i] = values[i] / rows[i][i]
    return values


def _is_zero(entry: Tensor | float) -> bool:
    return not isinstance(entry, Tensor) and entry == 0.0


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
    holds approximately (Feng & Michaelides 2009).
    """
    gain = params.area[:, None] * (update.velocity - state.velocity)
    spin_up = deformation.inertia * (update.angular_velocity - state.angular_velocity)
    hydro_force = gain - update.force
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
        torque_impulse=state.torque_impulse + update.torque,
        slip_error=update.slip_error,
        force=update.force,
        hydro_force=hydro_force,
        hydro_torque=spin_up - update.torque,
        impulse=state.impulse + hydro_force,
    )
