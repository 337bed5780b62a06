"""Rigid motion of the fish and its coupling to the flow.

Marker l sits at x_l = X + R(angle) (axial, lateral) and moves with V_l = U + (Omega - H/I) z x
r_l + R (0, Z_t). Fluid and body are solved together: with the force solve written as a linear map
P, g = P (U_d - U*) is linear in (U, Omega), so the new rigid velocity follows from one 3 x 3
system and the momentum that the body gains is exactly what the fluid loses. At equal density the
body's mass cancels against the fluid inside it and the skin is force-free; explicit coupling, as
the paper writes it, is unstable there (added mass).
"""

from enum import Enum
from math import pi
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.immersed_boundary import ForceSolve
from fishrl.physics.kinematics import Deformation, Modes, advance_phase


class Heading(Enum):
    """Who turns the fish."""

    FREE = "free"  # the flow's torque; three rigid degrees of freedom
    COMMANDED = "commanded"  # the command: Omega is prescribed, two degrees of freedom remain


class Coupling(Enum):
    """How force and rigid motion are solved."""

    IMPLICIT = "implicit"  # together; conserves momentum, stable at equal density
    EXPLICIT = "explicit"  # the paper's eqs. 5 and 6: the last step's velocity sets the force


class Body(NamedTuple):
    """State of the fish in each flow, float64, lattice units; every field starts with ``[B]``.

    Attributes:
        position: ``[B, 2]`` centre of mass (x, y).
        heading: direction that the fish faces, radians from +x, counter-clockwise.
        internal_angle: rotation of the momentum-free frame that the beating itself causes.
        velocity: ``[B, 2]`` of the centre of mass.
        angular_velocity: Omega, without the beating's own rotation.
        phase: of the body wave, radians.
        frequency: tail beats per step.
        age: steps since the fish began to swim.
        turn: commanded change of heading, radians.
        turn_steps: steps over which the turn is spread.
        turn_clock: steps since the command.
        work: done by the muscles since reset, rho (nodes / step)^2 nodes^2: sum of F . u_def.
        lateral_work: its lateral part, the paper's eqs. 12 and 13 with the sign of work done.
        torque_impulse: of the torque that holds a commanded heading.
        slip_error: largest velocity error at a marker in the last step.
        force: ``[B, 2]`` total force on the fluid in the last step.
    """

    position: Tensor
    heading: Tensor
    internal_angle: Tensor
    velocity: Tensor
    angular_velocity: Tensor
    phase: Tensor
    frequency: Tensor
    age: Tensor
    turn: Tensor
    turn_steps: Tensor
    turn_clock: Tensor
    work: Tensor
    lateral_work: Tensor
    torque_impulse: Tensor
    slip_error: Tensor
    force: Tensor


def make_body(position: Tensor, heading: Tensor, frequency: Tensor) -> Body:
    """Return a fish at rest, about to swim.

    Args:
        position: ``[B, 2]`` centre of mass in nodes.
        heading: ``[B]`` radians.
        frequency: ``[B]`` tail beats per step.
    """
    zero = torch.zeros_like(heading)
    return Body(
        position=position,
        heading=heading,
        internal_angle=zero,
        velocity=torch.zeros_like(position),
        angular_velocity=zero,
        phase=zero,
        frequency=frequency,
        age=zero,
        turn=zero,
        turn_steps=torch.ones_like(zero),
        turn_clock=torch.ones_like(zero),
        work=zero,
        lateral_work=zero,
        torque_impulse=zero,
        slip_error=zero,
        force=torch.zeros_like(position),
    )


def compute_turn_rate(body: Body) -> Tensor:
    """Return the commanded Omega ``[B]``: (turn / n) (1 - cos 2 pi t / n); its sum is ``turn``."""
    swing = 1.0 - torch.cos(2.0 * pi * (body.turn_clock + 0.5) / body.turn_steps)
    rate = body.turn / body.turn_steps * swing
    return torch.where(body.turn_clock < body.turn_steps, rate, torch.zeros_like(rate))


class Markers(NamedTuple):
    """Where the markers are and how they deform, ``[B, N, 2]`` each.

    Attributes:
        position: in nodes.
        arm: position relative to the centre of mass.
        deformation_velocity: velocity without the rigid motion, u_def.
    """

    position: Tensor
    arm: Tensor
    deformation_velocity: Tensor


def place_markers(body: Body, modes: Modes, shape: Deformation) -> Markers:
    """Carry the deformed outline into the flow; the body axis runs from head to tail."""
    angle = body.heading + pi + body.internal_angle
    cos, sin = torch.cos(angle)[:, None], torch.sin(angle)[:, None]
    rx = cos * modes.axial - sin * shape.lateral
    ry = sin * modes.axial + cos * shape.lateral
    spin = shape.spin[:, None]
    vx = -spin * ry - sin * shape.lateral_velocity
    vy = spin * rx + cos * shape.lateral_velocity
    arm = torch.stack((rx, ry), -1)
    return Markers(body.position[:, None] + arm, arm, torch.stack((vx, vy), -1))


class MarkerForce(NamedTuple):
    """Result of one coupled solve.

    Attributes:
        g: ``[B, N, 2]`` marker force, F = 2 rho g per unit length.
        velocity: ``[B, 2]`` new velocity of the centre of mass.
        angular_velocity: ``[B]`` new Omega.
        slip_error: ``[B]`` largest remaining velocity error at a marker.
        force: ``[B, 2]`` total force on the fluid.
        torque: ``[B]`` total torque on the fluid.
        power: ``[B]`` sum of F . u_def.
        lateral_power: ``[B]`` the part of it along the body's own lateral axis, without -H/I.
    """

    g: Tensor
    velocity: Tensor
    angular_velocity: Tensor
    slip_error: Tensor
    force: Tensor
    torque: Tensor
    power: Tensor
    lateral_power: Tensor


def solve_body_force(
    body: Body,
    shape: Deformation,
    markers: Markers,
    coupling_matrix: Tensor,
    velocity: Tensor,
    density: Tensor,
    *,
    spacing: float,
    excess_mass: float,
    excess_inertia: float,
    solve: ForceSolve,
    heading: Heading,
    coupling: Coupling,
) -> MarkerForce:
    """Find the marker force and the new rigid velocity together.

    Args:
        body: state at the start of the step.
        shape: deformation at this step.
        markers: their places at this step.
        coupling_matrix: A ``[B, N, N]``.
        velocity: ``[B, N, 2]`` unforced fluid velocity at the markers.
        density: ``[B, N]`` fluid density at the markers.
        spacing: marker spacing.
        excess_mass: body mass minus displaced fluid mass (the body mass itself if explicit).
        excess_inertia: the same for the moment of inertia.
        solve: the force solve P.
        heading: free or commanded.
        coupling: implicit, or the paper's explicit one (corrected sign: the body feels minus the
            force on the fluid).
    """
    dtype = coupling_matrix.dtype
    is_free = heading is Heading.FREE
    omega = body.angular_velocity if is_free else compute_turn_rate(body)
    arm = markers.arm.to(dtype)
    rx, ry = arm.unbind(-1)
    spin = torch.stack(
        (-omega[:, None] * markers.arm[..., 1], omega[:, None] * markers.arm[..., 0]), -1
    )
    target = body.velocity[:, None] + spin + markers.deformation_velocity
    residual = target.to(dtype) - velocity
    rows = [residual[..., 0], residual[..., 1], torch.ones_like(rx)]
    if is_free:
        rows += [-ry, rx]
    solution, rest = solve(coupling_matrix, torch.stack(rows, 1))
    mass = 2.0 * density * spacing

    def total(values: Tensor) -> Tensor:
        return (mass * values).sum(-1).double()

    gx, gy, p = solution.unbind(1)[:3]
    sx, sy, sp = rest.unbind(1)[:3]
    force_x, force_y = total(gx), total(gy)
    torque = total(rx * gy - ry * gx)
    if coupling is Coupling.EXPLICIT:
        change_x, change_y = -force_x / excess_mass, -force_y / excess_mass
        change = -torque / (excess_inertia * shape.inertia) if is_free else torch.zeros_like(omega)
    else:
        a = total(p) + excess_mass
        if is_free:
            px, py = solution[:, 3], solution[:, 4]
            c1, c2 = total(px), total(py)
            d1, d2 = total(-ry * p), total(rx * p)
            e = total(rx * py - ry * px) + excess_inertia * shape.inertia
            change = (-torque + (d1 * force_x + d2 * force_y) / a) / (e - (d1 * c1 + d2 * c2) / a)
            change_x, change_y = (-force_x - c1 * change) / a, (-force_y - c2 * change) / a
            w = change.to(dtype)[:, None]
            gx, gy = gx + w * px, gy + w * py
            sx, sy = sx + w * rest[:, 3], sy + w * rest[:, 4]
        else:
            change_x, change_y, change = -force_x / a, -force_y / a, torch.zeros_like(omega)
        wx, wy = change_x.to(dtype)[:, None], change_y.to(dtype)[:, None]
        gx, gy = gx + wx * p, gy + wy * p
        sx, sy = sx + wx * sp, sy + wy * sp
    u_def = markers.deformation_velocity.to(dtype)
    angle = body.heading + pi + body.internal_angle
    cos, sin = torch.cos(angle).to(dtype)[:, None], torch.sin(angle).to(dtype)[:, None]
    return MarkerForce(
        g=torch.stack((gx, gy), -1),
        velocity=body.velocity + torch.stack((change_x, change_y), -1),
        angular_velocity=omega + change,
        slip_error=torch.sqrt((sx * sx + sy * sy).amax(-1)).double(),
        force=torch.stack((total(gx), total(gy)), -1),
        torque=total(rx * gy - ry * gx),
        power=total(gx * u_def[..., 0] + gy * u_def[..., 1]),
        lateral_power=total((cos * gy - sin * gx) * shape.lateral_velocity.to(dtype)),
    )


def move_body(body: Body, shape: Deformation, result: MarkerForce) -> Body:
    """Advance the rigid motion, phase and ledgers by one step."""
    return body._replace(
        position=body.position + result.velocity,
        heading=body.heading + result.angular_velocity,
        internal_angle=body.internal_angle + shape.spin,
        velocity=result.velocity,
        angular_velocity=result.angular_velocity,
        phase=advance_phase(body.phase, body.frequency),
        age=body.age + 1.0,
        turn_clock=body.turn_clock + 1.0,
        work=body.work + result.power,
        lateral_work=body.lateral_work + result.lateral_power,
        torque_impulse=body.torque_impulse + result.torque,
        slip_error=result.slip_error,
        force=result.force,
    )
