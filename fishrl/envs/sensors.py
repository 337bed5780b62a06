"""Geometric sensors as functions of tensors with a leading batch axis.

They only use operations whose rounding does not depend on the position in the batch. ``atan2`` and
``hypot`` have vectorised and scalar versions that differ in the last bit, so that a row would
change with the batch size; ``atan``, ``sqrt``, ``sin`` and ``cos`` do not.
"""

from math import pi

import torch
from torch import Tensor

from fishrl.physics.flow import FlowConfig

#: The numbers of ``sense_target``.
TARGET = ("x [L]", "y [L]", "distance [L]", "bearing error, positive to the left [rad]")
#: Their mirror image.
MIRRORED_TARGET = (1, -2, 3, -4)


def wrap_angle(angle: Tensor) -> Tensor:
    """Wrap angles to (-pi, pi] radians."""
    return pi - torch.remainder(pi - angle, 2.0 * pi)


def compute_bearing_error(heading: Tensor, away: Tensor) -> Tensor:
    """Return the angle ``[B]`` from the heading ``[B]`` to a direction ``[B, 2]`` of any length.

    It lies in (-pi, pi] radians, positive to the left (counter-clockwise); 0 for a zero vector.
    """
    cos, sin = torch.cos(heading), torch.sin(heading)
    ahead = cos * away[:, 0] + sin * away[:, 1]
    left = cos * away[:, 1] - sin * away[:, 0]
    angle = torch.atan(left / ahead)
    behind = torch.where(left >= 0.0, angle + pi, angle - pi)
    angle = torch.where(ahead < 0.0, behind, angle)
    return torch.where((ahead == 0.0) & (left == 0.0), torch.zeros_like(angle), angle)


def sense_target(head: Tensor, heading: Tensor, target: Tensor, *, body_length: float) -> Tensor:
    """Return where a target ``[B, 2]`` is from the nose ``[B, 2]``, both in nodes: ``TARGET``.

    That is ``[B, 4]``, lengths in body lengths; ``heading`` ``[B]`` is in radians and
    ``body_length`` in nodes.
    """
    away = (target - head) / body_length
    distance = (away * away).sum(-1).sqrt()
    bearing_error = compute_bearing_error(heading, away)
    return torch.stack((away[:, 0], away[:, 1], distance, bearing_error), -1)


def compute_clearance(markers: Tensor, flow: FlowConfig) -> Tensor:
    """Return how far markers ``[B, N, 2]`` are from the nearest of ``flow.edges``, ``[B]``, nodes.

    Negative outside, and NaN if a marker is NaN.
    """
    x, y = markers.unbind(-1)
    (left, bottom), (right, top) = flow.edges
    gaps = (x - left, right - x, y - bottom, top - y)
    return torch.stack(gaps, -1).flatten(1).amin(-1)


def compute_gap(one: Tensor, other: Tensor) -> Tensor:
    """Return the least distance ``[B]`` of markers ``[B, N, 2]`` and ``[B, M, 2]``, nodes."""
    distance = torch.cdist(one, other, compute_mode="donot_use_mm_for_euclid_dist")
    return distance.flatten(1).amin(-1)
