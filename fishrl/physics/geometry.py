"""Where the bodies are: markers carried from each body's own frame into the flow."""

from math import pi
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.gait import Deformation
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState


class Markers(NamedTuple):
    """Where the markers of one body are and how they deform, ``[B, N, 2]`` each."""

    position: Tensor  #: in nodes
    arm: Tensor  #: position relative to the centre of mass
    deformation_velocity: Tensor  #: velocity without the rigid motion, u_def


class Outline(NamedTuple):
    """The outline of one body in one step."""

    deformation: Deformation  #: how the body deforms, in its own frame
    markers: Markers  #: where its markers are


def locate_outline(config: BodyConfig, params: BodyParams, state: BodyState) -> Outline:
    """Deform a body and place its markers."""
    deformation = deform_body(config, params, state)
    return Outline(deformation, place_markers(state, deformation))


def deform_body(config: BodyConfig, params: BodyParams, state: BodyState) -> Deformation:
    """Return the outline of a body in its own frame and its velocity there."""
    return params.deform(state, config.motion.compute_bend_rate(state))


def locate_markers(params: BodyParams, state: BodyState) -> Tensor:
    """Return the positions of ``place_markers`` alone, ``[B, N, 2]`` in nodes."""
    return state.position[:, None] + rotate(state, *params.draw(state))


def place_markers(state: BodyState, deformation: Deformation) -> Markers:
    """Carry the deformed outline into the flow; the body axis runs from head to tail."""
    arm = rotate(state, deformation.axial, deformation.lateral)
    rx, ry = arm.unbind(-1)
    spin = deformation.spin[:, None]
    velocity = rotate(state, deformation.axial_velocity, deformation.lateral_velocity)
    velocity = velocity + join(-spin * ry, spin * rx)
    return Markers(state.position[:, None] + arm, arm, velocity)


def rotate(state: BodyState, axial: Tensor, lateral: Tensor) -> Tensor:
    """Rotate vectors along and across the body's axis into the flow's frame, ``[B, N, 2]``."""
    cos, sin = compute_axis(state)
    cos, sin = cos[:, None], sin[:, None]
    return join(cos * axial - sin * lateral, sin * axial + cos * lateral)


def join(x: Tensor, y: Tensor) -> Tensor:
    """Return vectors ``[B, N, 2]`` whose components ``[B, N]`` lie apart in memory, for loops."""
    return torch.stack((x, y), 1).mT


def compute_velocity(markers: Markers, velocity: Tensor, angular_velocity: Tensor) -> Tensor:
    """Return the markers' velocity ``[B, N, 2]`` at rates ``[B, 2]`` and ``[B]`` of the body."""
    (rx, ry), (ux, uy) = markers.arm.unbind(-1), markers.deformation_velocity.unbind(-1)
    (x, y), omega = velocity[..., None].unbind(1), angular_velocity[:, None]
    return join(x - omega * ry + ux, y + omega * rx + uy)


def compute_axis(state: BodyState) -> tuple[Tensor, Tensor]:
    """Return the direction (cos, sin) ``[B]`` of the body's axis, from nose to tail."""
    angle = state.heading + pi + state.internal_angle
    return torch.cos(angle), torch.sin(angle)
