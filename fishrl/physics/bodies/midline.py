"""Deformation of an inextensible midline, after Gazzola et al. and CubismUP.

A gait gives the slope y_s = Z'(s) at arc length s, so x_s = sqrt(1 - y_s^2); strokes give the
curvature instead (``strokes.py``). The sections of the body stay normal to the midline, r = (x, y)
+ eta n with n = (-y_s, x_s). In vertical shear (``shear.py``) a beating body's midline grows
longer; here its length and the area are conserved, at the price of an integral along the body in
every step.

With curvature kappa a section of half-thickness h holds 2 h ds of mass and, about its midline
point, -(2 h^3 / 3) kappa ds of first and 2 h^3 / 3 ds of second moment.
"""

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from fishrl.physics.bodies.gait import Deformation, compute_amplitude_rates, compute_amplitudes
from fishrl.physics.bodies.state import BodyState

_Pair = tuple[Tensor, Tensor]


class Midline(NamedTuple):
    """A midline and its change per step; ``[B, S]``, of vectors a pair (x, y)."""

    points: _Pair  #: in nodes, in a frame of its own
    tangent: _Pair  #: unit vector from nose to tail
    curvature: Tensor  #: kappa, per node
    points_rate: _Pair  #: change of ``points``
    tangent_rate: _Pair  #: change of ``tangent``
    curvature_rate: Tensor  #: change of ``curvature``


class Curve(Protocol):
    """What sets a midline at one instant."""

    def draw(self, body: BodyState, bend_rate: Tensor, step: Tensor) -> Midline:
        """Return the midline.

        ``bend_rate`` ``[B]`` is the change per step of the bend, ``step`` ``[B, S]`` the arc length
        from the point before.
        """


class Slope(NamedTuple):
    """A gait's midline, given by its slope."""

    #: ``[B, 3, 3, S]`` the three modes (sine, cosine, bend), Z, and Z', Z'' along the midline
    modes: Tensor

    def draw(self, body: BodyState, bend_rate: Tensor, step: Tensor) -> Midline:
        """Return the midline; see ``Curve``."""
        e, e_t = compute_amplitudes(body), compute_amplitude_rates(body, bend_rate)

        def combine(order: int, amplitudes: list[Tensor]) -> Tensor:
            parts = [self.modes[:, k, order] * a[:, None] for k, a in enumerate(amplitudes)]
            return parts[0] + parts[1] + parts[2]

        y_s, y_st = combine(1, e), combine(1, e_t)
        x_s = torch.sqrt(1.0 - y_s * y_s)
        x_st = -y_s * y_st / x_s
        return Midline(
            points=(accumulate(x_s, step), combine(0, e)),
            tangent=(x_s, y_s),
            curvature=combine(2, e) / x_s,
            points_rate=(accumulate(x_st, step), combine(0, e_t)),
            tangent_rate=(x_st, y_st),
            curvature_rate=(combine(2, e_t) - combine(2, e) * x_st / x_s) / x_s,
        )


def accumulate(slope: Tensor, step: Tensor) -> Tensor:
    """Integrate ``[B, S]`` along the midline from the nose, by trapezes."""
    before = torch.cat((slope[:, :1], slope[:, :-1]), 1)
    return torch.cumsum(0.5 * (slope + before) * step, 1)


class MidlineParams(NamedTuple):
    """A fish along its midline, lattice units; ``[B, ...]`` or ``[1, ...]``, float64."""

    spacing: Tensor  #: ``[B, N]`` length of outline that each marker represents
    lateral: Tensor  #: ``[B, N]`` signed distance of each marker from the midline
    station: Tensor  #: ``[B, N]`` index of the midline point that each marker belongs to
    step: Tensor  #: ``[B, S]`` arc length from each midline point to the one before (first: 0)
    weight: Tensor  #: ``[B, S]`` arc length that each midline point represents
    half: Tensor  #: ``[B, S]`` half-thickness
    curve: Curve  #: what sets the midline
    area: Tensor  #: ``[B]`` of the body
    density_ratio: Tensor  #: ``[B]`` body density over fluid density

    def draw(self, body: BodyState) -> tuple[Tensor, Tensor]:
        """Return the markers along and across the axis ``[B, N]``, without their velocity."""
        deformation = self.deform(body, torch.zeros_like(body.bend))
        return deformation.axial, deformation.lateral

    def deform(self, body: BodyState, bend_rate: Tensor) -> Deformation:
        """Return the outline and its velocity in the momentum-free frame.

        The frame keeps the centre of area in place and has no angular momentum. The linear momentum
        (the integral of the deformation velocity over the area) vanishes in vertical shear but not
        here, as the sections rotate: it is 1 to 2 % of the integral of that velocity's magnitude.
        """
        line = self.curve.draw(body, bend_rate, self.step)
        mass, second = 2.0 * self.half * self.weight, 2.0 / 3.0 * self.half**3 * self.weight
        first, first_t = line.curvature * second, line.curvature_rate * second
        normal, normal_t = _turn(line.tangent), _turn(line.tangent_rate)
        whole = mass.sum(-1, keepdim=True)

        def total(values: Tensor) -> Tensor:
            return values.sum(-1)

        def centre(points: Tensor, moment: Tensor) -> Tensor:
            """Return midline points, or velocities, relative to the centre of area."""
            return points - (total(mass * points) - total(moment))[:, None] / whole

        (x, y), (x_t, y_t) = line.points, line.points_rate
        middle = centre(x, first * normal[0]), centre(y, first * normal[1])
        middle_t = (
            centre(x_t, first * normal_t[0] + first_t * normal[0]),
            centre(y_t, first * normal_t[1] + first_t * normal[1]),
        )
        inertia = total(mass * _dot(middle, middle) + second - 2.0 * first * _dot(middle, normal))
        mixed = _cross(middle, normal_t) + _cross(normal, middle_t)
        momentum = total(
            mass * _cross(middle, middle_t) + second * _cross(normal, normal_t) - first * mixed
        )
        stretch = _dot(middle, normal_t) + _dot(normal, middle_t)
        moment_rate = first * stretch + first_t * _dot(middle, normal)
        rate = total(2.0 * mass * _dot(middle, middle_t) - 2.0 * moment_rate)
        station = self.station.long().expand(len(momentum), -1)

        def at_markers(centre: Tensor, across: Tensor) -> Tensor:
            return centre.gather(1, station) + self.lateral * across.gather(1, station)

        return Deformation(
            axial=at_markers(middle[0], normal[0]),
            lateral=at_markers(middle[1], normal[1]),
            axial_velocity=at_markers(middle_t[0], normal_t[0]),
            lateral_velocity=at_markers(middle_t[1], normal_t[1]),
            spin=-momentum / inertia,
            inertia=inertia,
            inertia_rate=rate,
        )


def _turn(a: _Pair) -> _Pair:
    """Return a vector turned by 90 degrees."""
    return -a[1], a[0]


def _dot(a: _Pair, b: _Pair) -> Tensor:
    return a[0] * b[0] + a[1] * b[1]


def _cross(a: _Pair, b: _Pair) -> Tensor:
    return a[0] * b[1] - a[1] * b[0]
