"""Where the bodies are: markers carried from each body's own frame into the flow."""

from collections.abc import Sequence
from math import pi
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.gait import Deformation
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.flow import FlowConfig
from fishrl.physics.immersed_boundary import Stencil, make_stencil, overlap_markers


class Markers(NamedTuple):
    """Where the markers of one body are and how they deform, ``[B, N, 2]`` each."""

    position: Tensor  #: in nodes
    arm: Tensor  #: position relative to the centre of mass
    deformation_velocity: Tensor  #: velocity without the rigid motion, u_def


class Outlines(NamedTuple):
    """The outlines of all bodies in one step."""

    deformations: tuple[Deformation, ...]  #: deformation of each body
    markers: tuple[Markers, ...]  #: markers of each body


class BodyGeometry(NamedTuple):
    """All bodies in one step; the markers of the bodies follow each other in N."""

    outlines: Outlines  #: how the bodies deform and where their markers are
    spacing: Tensor  #: ``[B, N]`` length of outline that each marker represents
    stencil: Stencil  #: nodes around all markers
    operator: tuple[Tensor, ...]  #: what the force solve needs, from ``ForceSolve.prepare``


def locate_bodies(
    config: FlowConfig,
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    dtype: torch.dtype,
) -> BodyGeometry:
    """Deform the bodies, place their markers, find the nodes around them; weights of ``dtype``."""
    outlines = locate_outlines(config, params, states)
    positions = torch.cat([m.position for m in outlines.markers], 1)
    stencil = make_stencil(positions, config.width, config.height, dtype)
    spacing = torch.cat([p.spacing.to(dtype).expand(len(positions), -1) for p in params], -1)
    operator = config.force_solve.prepare(overlap_markers(stencil), spacing)
    return BodyGeometry(outlines, spacing, stencil, operator)


def locate_outlines(
    config: FlowConfig, params: Sequence[BodyParams], states: Sequence[BodyState]
) -> Outlines:
    """Deform the bodies and place their markers."""
    bodies = zip(config.bodies, params, states, strict=True)
    deformations = tuple(deform_body(body, own, state) for body, own, state in bodies)
    markers = tuple(place_markers(s, d) for s, d in zip(states, deformations, strict=True))
    return Outlines(deformations, markers)


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
    velocity = velocity + torch.stack((-spin * ry, spin * rx), -1)
    return Markers(state.position[:, None] + arm, arm, velocity)


def rotate(state: BodyState, axial: Tensor, lateral: Tensor) -> Tensor:
    """Rotate vectors along and across the body's axis into the flow's frame, ``[B, N, 2]``."""
    cos, sin = compute_axis(state)
    cos, sin = cos[:, None], sin[:, None]
    return torch.stack((cos * axial - sin * lateral, sin * axial + cos * lateral), -1)


def compute_axis(state: BodyState) -> tuple[Tensor, Tensor]:
    """Return the direction (cos, sin) ``[B]`` of the body's axis, from nose to tail."""
    angle = state.heading + pi + state.internal_angle
    return torch.cos(angle), torch.sin(angle)
