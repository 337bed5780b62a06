"""Rigid motion of the bodies and its coupling to the flow.

Marker l sits at x_l = X + R(angle) (axial, lateral) and moves with V_l = U + (Omega - H/I) z x
r_l + R u_deform. Fluid and bodies are solved together: with the force solve written as a linear map
P, g = P (U_d - U*) is linear in every body's (U, Omega), so the new rigid velocities follow from
one small system and the momentum that a body gains is exactly what the fluid loses. At equal
density the body's mass cancels against the fluid inside it and the skin is force-free; explicit
coupling, as the paper writes it, is unstable there (added mass).
"""

from collections.abc import Sequence
from enum import Enum
from itertools import accumulate
from math import pi
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from fishrl.physics.bodies.gait import Beat, Deformation, advance_phase
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.immersed_boundary import ForceSolve


class Coupling(Enum):
    """How force and rigid motion are solved."""

    IMPLICIT = "implicit"  # together; conserves momentum, stable at equal density
    EXPLICIT = "explicit"  # the paper's eqs. 5 and 6: the last step's velocity sets the force


class Markers(NamedTuple):
    """Where the markers of one body are and how they deform, ``[B, N, 2]`` each.

    Attributes:
        position: in nodes.
        arm: position relative to the centre of mass.
        deformation_velocity: velocity without the rigid motion, u_def.
    """

    position: Tensor
    arm: Tensor
    deformation_velocity: Tensor


def deform_body(outline: BodyConfig, shape: BodyParams, body: BodyState) -> Deformation:
    """Return the outline of a body in its own frame."""
    return shape.deform(_read_beat(outline, body))


def locate_markers(outline: BodyConfig, shape: BodyParams, body: BodyState) -> Tensor:
    """Return the positions of ``place_markers`` alone, ``[B, N, 2]`` in nodes."""
    axial, lateral = shape.draw(_read_beat(outline, body))
    return body.position[:, None] + _turn(body, axial, lateral)


def _read_beat(outline: BodyConfig, body: BodyState) -> Beat:
    rate = outline.motion.compute_bend_rate(body)
    return Beat(body.phase, body.frequency, body.beats, body.bend, rate)


def _turn(body: BodyState, axial: Tensor, lateral: Tensor) -> Tensor:
    """Turn vectors along and across the body's axis into the flow's frame, ``[B, N, 2]``."""
    angle = body.heading + pi + body.internal_angle
    cos, sin = torch.cos(angle)[:, None], torch.sin(angle)[:, None]
    return torch.stack((cos * axial - sin * lateral, sin * axial + cos * lateral), -1)


def place_markers(body: BodyState, deformation: Deformation) -> Markers:
    """Carry the deformed outline into the flow; the body axis runs from head to tail."""
    arm = _turn(body, deformation.axial, deformation.lateral)
    rx, ry = arm.unbind(-1)
    spin = deformation.spin[:, None]
    velocity = _turn(body, deformation.axial_velocity, deformation.lateral_velocity)
    velocity = velocity + torch.stack((-spin * ry, spin * rx), -1)
    return Markers(body.position[:, None] + arm, arm, velocity)


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


class _Freedom(NamedTuple):
    """One rigid degree of freedom that the flow decides.

    Attributes:
        body: number of its body.
        axis: 0 and 1 for the centre of mass along x and y, 2 for turning.
        unit: velocity (x, y) that a unit of it gives all markers, ``[B, N]``; None is zero.
        rows: of the force solve whose right-hand sides these are.
    """

    body: int
    axis: int
    unit: tuple[Tensor | None, Tensor | None]
    rows: tuple[int | None, int | None]


def solve_body_force(
    outlines: Sequence[BodyConfig],
    shapes: Sequence[BodyParams],
    bodies: Sequence[BodyState],
    deformations: Sequence[Deformation],
    markers: Sequence[Markers],
    operator: Sequence[Tensor],
    velocity: Tensor,
    density: Tensor,
    *,
    solve: ForceSolve,
    coupling: Coupling,
) -> tuple[Tensor, list[RigidUpdate]]:
    """Find the marker force and the new rigid velocities of all bodies together.

    Args:
        outlines: what the bodies are; their markers follow each other in N.
        shapes: of each body.
        bodies: their states at the start of the step.
        deformations: of each at this step.
        markers: of each at this step.
        operator: of the force solve, from ``solve.prepare``.
        velocity: ``[B, 2, N]`` unforced fluid velocity at the markers.
        density: ``[B, N]`` fluid density at the markers.
        solve: the force solve P.
        coupling: implicit, or the paper's explicit one (corrected sign: the body feels minus the
            force on the fluid).

    Returns:
        g ``[B, 2, N]``, with F = 2 rho g per unit length, and an update per body.
    """
    dtype, num_bodies = velocity.dtype, len(outlines)
    ends = list(accumulate(outline.num_markers for outline in outlines))
    own = [slice(b - o.num_markers, b) for b, o in zip(ends, outlines, strict=True)]
    spacing = torch.cat([s.spacing.to(dtype).expand(len(density), -1) for s in shapes], -1)
    mass = 2.0 * density * spacing

    def widen(values: Tensor, m: int) -> Tensor:
        """Return values of body m at all markers, zero at the others'."""
        return pad(values, (own[m].start, ends[-1] - ends[m])) if num_bodies > 1 else values

    def total(values: Tensor, m: int) -> Tensor:
        """Sum over the markers of body m, each with the fluid mass that it moves."""
        return (mass * values)[:, own[m]].sum(-1).double()

    def project(i: _Freedom, gx: Tensor | None, gy: Tensor | None) -> Tensor | float:
        """Return the force or torque along a degree of freedom that (gx, gy) puts on the fluid."""
        pairs = zip(i.unit, (gx, gy), strict=True)
        parts = [unit * g for unit, g in pairs if unit is not None and g is not None]
        return total(sum(parts[1:], parts[0]), i.body) if parts else 0.0

    arms = [[arm.to(dtype) for arm in place.arm.unbind(-1)] for place in markers]
    rates: list[list[Tensor]] = []  # (U_x, U_y, Omega) of each body
    targets: list[Tensor] = []
    freedoms: list[_Freedom] = []
    right: list[Tensor] = []  # sides of the force solve beside the slip itself
    for m, (outline, body, place) in enumerate(zip(outlines, bodies, markers, strict=True)):
        motion, (given, turn_rate) = outline.motion, outline.motion.prescribe(body)
        linear = body.velocity if motion.moves_freely else given
        omega = body.angular_velocity if motion.turns_freely else turn_rate
        rates.append([*linear.unbind(-1), omega])
        spin = torch.stack((-place.arm[..., 1], place.arm[..., 0]), -1) * omega[:, None, None]
        targets.append((linear[:, None] + spin + place.deformation_velocity).to(dtype).mT)
        rx, ry = arms[m]
        row = 2 + len(right)
        if motion.moves_freely:
            one = widen(torch.ones_like(rx), m)
            right.append(one)
            freedoms += [_Freedom(m, 0, (one, None), (row, None))]
            freedoms += [_Freedom(m, 1, (None, one), (None, row))]
            row += 1
        if motion.turns_freely:
            right += [widen(-ry, m), widen(rx, m)]
            freedoms += [_Freedom(m, 2, (right[-2], right[-1]), (row, row + 1))]
    residual = torch.cat(targets, -1) - velocity
    solution, rest = solve(operator, torch.stack([*residual.unbind(1), *right], 1))

    def respond(of: Tensor, i: _Freedom) -> list[Tensor | None]:
        return [None if row is None else of[:, row] for row in i.rows]

    g, slip = list(solution[:, :2].unbind(1)), list(rest[:, :2].unbind(1))
    is_implicit = coupling is Coupling.IMPLICIT
    matrix, drive = [], []
    for i in freedoms:
        shape, body, deformation = shapes[i.body], bodies[i.body], deformations[i.body]
        excess = shape.density_ratio - (1.0 if is_implicit else 0.0)
        push = -project(i, *g)
        if i.axis == 2:
            inertia = excess * deformation.inertia
            push = push - excess * deformation.inertia_rate * body.angular_velocity
        else:
            inertia = excess * shape.area
            push = push + body.load[:, i.axis]
        matrix.append(
            [
                (project(i, *respond(solution, j)) if is_implicit else 0.0)
                + (inertia if i is j else 0.0)
                for j in freedoms
            ]
        )
        drive.append(push)
    for i, change in zip(freedoms, eliminate(matrix, drive), strict=True):
        rates[i.body][i.axis] = rates[i.body][i.axis] + change
        if is_implicit:
            weight = change.to(dtype)[:, None]
            for values, of in ((g, solution), (slip, rest)):
                for axis, answer in enumerate(respond(of, i)):
                    if answer is not None:
                        values[axis] = values[axis] + weight * answer
    gx, gy = g
    square = slip[0] * slip[0] + slip[1] * slip[1]
    updates = []
    for m, (body, deformation) in enumerate(zip(bodies, deformations, strict=True)):
        (rx, ry), mine = arms[m], own[m]
        ux, uy = markers[m].deformation_velocity.to(dtype).unbind(-1)
        angle = body.heading + pi + body.internal_angle
        cos, sin = torch.cos(angle).to(dtype)[:, None], torch.sin(angle).to(dtype)[:, None]
        across = deformation.lateral_velocity.to(dtype)
        fx, fy = (mass * gx)[:, mine], (mass * gy)[:, mine]
        power = fx * ux + fy * uy
        updates.append(
            RigidUpdate(
                velocity=torch.stack(rates[m][:2], -1),
                angular_velocity=rates[m][2],
                slip_error=square[:, mine].amax(-1).sqrt().double(),
                force=torch.stack((fx.sum(-1).double(), fy.sum(-1).double()), -1),
                torque=(rx * fy - ry * fx).sum(-1).double(),
                power=power.sum(-1).double(),
                positive_power=power.clamp_min(0.0).sum(-1).double(),
                lateral_power=((cos * fy - sin * fx) * across).sum(-1).double(),
            )
        )
    return torch.stack(g, 1), updates


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
    outline: BodyConfig,
    shape: BodyParams,
    body: BodyState,
    deformation: Deformation,
    update: RigidUpdate,
) -> BodyState:
    """Advance rigid motion, phase and ledgers of one body by one step.

    The markers' force also drives the fluid inside the body, whose momentum is exactly the
    displaced mass times the body's velocity: hydro_force = m_f dU/dt - F. For the torque the same
    holds approximately (Feng & Michaelides 2009).
    """
    gain = shape.area[:, None] * (update.velocity - body.velocity)
    spin_up = deformation.inertia * (update.angular_velocity - body.angular_velocity)
    hydro_force = gain - update.force
    is_still = outline.motion.is_still
    return body._replace(
        position=body.position + (0.0 if is_still else update.velocity),
        heading=body.heading + (0.0 if is_still else update.angular_velocity),
        internal_angle=body.internal_angle + deformation.spin,
        velocity=update.velocity,
        angular_velocity=update.angular_velocity,
        phase=advance_phase(body.phase, body.frequency),
        beats=body.beats + body.frequency,
        age=body.age + 1.0,
        bend=body.bend + outline.motion.compute_bend_rate(body),
        turn_clock=body.turn_clock + 1.0,
        work=body.work + update.power,
        positive_work=body.positive_work + update.positive_power,
        lateral_work=body.lateral_work + update.lateral_power,
        torque_impulse=body.torque_impulse + update.torque,
        slip_error=update.slip_error,
        force=update.force,
        hydro_force=hydro_force,
        hydro_torque=spin_up - update.torque,
        impulse=body.impulse + hydro_force,
    )
