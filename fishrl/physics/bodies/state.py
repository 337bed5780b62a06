"""State of a body: position, velocity, phase, current command and accumulated totals."""

from typing import NamedTuple

import torch
from torch import Tensor


class BodyState(NamedTuple):
    """State of one body in each flow, float64, lattice units; every field starts with ``[B]``."""

    position: Tensor  #: ``[B, 2]`` centre of mass (x, y)
    heading: Tensor  #: direction that the nose faces, radians from +x, counter-clockwise
    internal_angle: Tensor  #: rotation of the momentum-free frame that the beating itself causes
    velocity: Tensor  #: ``[B, 2]`` of the centre of mass
    angular_velocity: Tensor  #: Omega, without the beating's own rotation
    phase: Tensor  #: phase of the body wave or oscillation, radians
    frequency: Tensor  #: tail beats or oscillations per step; a negative one reverses the wave
    beats: Tensor  #: tail beats or oscillations since reset
    age: Tensor  #: steps since reset
    bend: Tensor  #: kappa of the midline's bend kappa L x^2; see ``Bending``
    amplitude: Tensor  #: share of the gait's amplitude; see ``gait.compute_amplitude_rate``
    amplitude_goal: Tensor  #: commanded share
    turn: Tensor  #: commanded change of heading, radians
    turn_steps: Tensor  #: steps over which the turn is spread
    turn_clock: Tensor  #: steps since the command
    load: Tensor  #: ``[B, 2]`` external force on the body: weight minus buoyancy, a tether
    #: net work of the muscles since reset, rho (nodes / step)^2 nodes^2: sum of F . u_def
    work: Tensor
    positive_work: Tensor  #: the same without recovery: negative power at a marker counts as zero
    lateral_work: Tensor  #: its lateral part, the paper's eqs. 12 and 13 with the sign of work done
    #: done by the external torque that sets Omega: sum of torque times Omega; zero for a free body.
    #: With ``work`` it is the work on the water, if no external force acts
    torque_work: Tensor
    torque_impulse: Tensor  #: sum of the torque on the fluid over all steps
    slip_error: Tensor  #: largest velocity error at a marker in the last step, without gradient
    #: ``[B, 2]`` force on the fluid in the last step, the fluid inside the body included
    force: Tensor
    hydro_force: Tensor  #: ``[B, 2]`` force of the fluid outside on the body in the last step
    hydro_torque: Tensor  #: torque of the fluid outside on the body in the last step
    surplus: Tensor  #: mass that a sharp skin has given to the water and not yet taken back
    #: ``[B, 3]`` momentum along x and y and angular momentum of water that a sharp skin has covered
    #: while it slipped past, not yet felt by the body
    slip_impulse: Tensor
    impulse: Tensor  #: ``[B, 2]`` sum of ``hydro_force`` over all steps


def make_body(position: Tensor, heading: Tensor, frequency: Tensor) -> BodyState:
    """Return the state of a body at rest.

    ``position`` ``[B, 2]`` is the centre of mass in nodes, ``heading`` ``[B]`` in radians,
    ``frequency`` ``[B]`` in tail beats or oscillations per step.
    """
    zero, pair = torch.zeros_like(heading), torch.zeros_like(position)
    pairs = {"velocity", "load", "force", "hydro_force", "impulse"}
    rest = {name: pair if name in pairs else zero for name in BodyState._fields}
    rest["slip_impulse"] = torch.stack((zero, zero, zero), -1)
    ones = ("amplitude", "amplitude_goal", "turn_steps", "turn_clock")
    given = {"position": position, "heading": heading, "frequency": frequency}
    return BodyState(**rest | given | dict.fromkeys(ones, torch.ones_like(zero)))
