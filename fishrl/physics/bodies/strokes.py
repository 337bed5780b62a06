"""Strokes that bend the midline to given curvatures, as in a C-start (Gazzola et al. 2012).

The curvature at arc length s, which the midline follows however far it bends, is

    kappa(s, t) = B(s, t) + K(s, t) sin(2 pi (t / T - tau(t) s / L) + phi).

The bend B and the amplitude K of the wave are natural cubic splines through three values, at s / L
= 0.5, 0.75 and 0.95, and through zero at 0, 0.2 and 1. In each stroke these six values and tau go
to new ones as 3 p^2 - 2 p^3, p from 0 to 1; after the last stroke they stay, and the wave runs on.
So the open-source CubismUP 2D does (``CStartFish``); its tau rises with the curvatures, too.
"""

from math import pi
from typing import Annotated, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat
from torch import Tensor

from fishrl.physics.bodies.midline import Midline, accumulate
from fishrl.physics.bodies.outline import to_tensors
from fishrl.physics.bodies.state import BodyState
from fishrl.settings import Settings

_Values = NDArray[np.float64]
_Three = tuple[float, float, float]

_KNOTS = np.array([0.0, 0.2, 0.5, 0.75, 0.95, 1.0])
_FREE = slice(2, 5)  # knots whose values are given; at the others the curvature is zero


class Stroke(Settings):
    """A smooth change of the curvature.

    Args:
        duration: duration of the change, in T.
        bend: B L at s / L = 0.5, 0.75 and 0.95 when it ends.
        wave: K L at the same points.
        lag: tau when it ends, waves along the body.
    """

    duration: PositiveFloat
    bend: _Three
    wave: _Three
    lag: float


class Strokes(Settings):
    """A sequence of strokes that begins straight, at rest and with tau = 0.

    Args:
        sequence: strokes, in order.
        phase: phi, radians.
    """

    sequence: Annotated[tuple[Stroke, ...], Field(min_length=1)]
    phase: float = 0.0

    def bound_curvature(self, x: _Values) -> _Values:
        """Return a bound abs(B) + abs(K) of the curvature at ``x`` = s / L, in 1 / L."""
        splines = _draw_splines(x)
        ends = [
            abs(np.array(one.bend) @ splines) + abs(np.array(one.wave) @ splines)
            for one in self.sequence
        ]
        return np.asarray(np.max(ends, axis=0), dtype=np.float64)

    def make_curve(self, x: _Values, body_length: float, device: torch.device | str) -> "Curvature":
        """Return the curve of a midline with points at ``x`` = s / L, ``[S]``."""
        goals = np.array([[*one.bend, *one.wave, one.lag] for one in self.sequence])
        duration = np.array([one.duration for one in self.sequence])
        return Curvature(
            **to_tensors(
                device,
                arc=x,
                splines=_draw_splines(x) / body_length,
                start=np.cumsum(duration) - duration,
                duration=duration,
                change=np.diff(goals, axis=0, prepend=0.0),
                phase=self.phase,
            )
        )


class Curvature(NamedTuple):
    """A midline given by its curvature in n strokes, lattice units."""

    arc: Tensor  #: ``[B, S]`` s / L of the midline points
    splines: Tensor  #: ``[B, 3, S]`` curvature of unit values at the three control points
    start: Tensor  #: ``[B, n]`` time at which each stroke begins, in T
    duration: Tensor  #: ``[B, n]`` of each stroke, in T
    #: ``[B, n, 7]`` of the bend's and the wave's three values and of tau in each stroke
    change: Tensor
    phase: Tensor  #: ``[B]`` phi

    def draw(self, body: BodyState, bend_rate: Tensor, step: Tensor) -> Midline:
        """Return the midline; see ``midline.Curve``. ``body.beats`` is t / T."""
        time, frequency = body.beats[:, None], body.frequency.abs()[:, None]
        part = ((time - self.start) / self.duration).clamp(0.0, 1.0)
        rise = 6.0 * part * (1.0 - part) / self.duration * frequency
        values = (self.change * (part * part * (3.0 - 2.0 * part))[..., None]).sum(1)
        rates = (self.change * rise[..., None]).sum(1)

        def spread(three: Tensor) -> Tensor:
            return (three[..., None] * self.splines).sum(1)

        bend, wave = spread(values[:, :3]), spread(values[:, 3:6])
        angle = 2.0 * pi * (time - values[:, 6:] * self.arc) + self.phase[:, None]
        angle_rate = 2.0 * pi * (frequency - rates[:, 6:] * self.arc)
        sin, cos = torch.sin(angle), torch.cos(angle)
        curvature = bend + wave * sin
        rate = spread(rates[:, :3]) + spread(rates[:, 3:6]) * sin + wave * cos * angle_rate
        theta, theta_rate = accumulate(curvature, step), accumulate(rate, step)
        x_s, y_s = torch.cos(theta), torch.sin(theta)
        x_st, y_st = -y_s * theta_rate, x_s * theta_rate
        return Midline(
            points=(accumulate(x_s, step), accumulate(y_s, step)),
            tangent=(x_s, y_s),
            curvature=curvature,
            points_rate=(accumulate(x_st, step), accumulate(y_st, step)),
            tangent_rate=(x_st, y_st),
            curvature_rate=rate,
        )


def _draw_splines(x: _Values) -> _Values:
    """Return the natural cubic splines at ``x`` that are 1 at one of the free knots, ``[3, n]``."""
    unit, width = np.eye(len(_KNOTS)), np.diff(_KNOTS)
    slope = np.diff(unit, axis=0) / width[:, None]
    inner = width[1:-1]
    matrix = np.diag(2.0 * (width[:-1] + width[1:])) + np.diag(inner, 1) + np.diag(inner, -1)
    second = np.zeros_like(unit)
    second[1:-1] = np.linalg.solve(matrix, 6.0 * np.diff(slope, axis=0))
    i = np.clip(np.searchsorted(_KNOTS, x, side="right") - 1, 0, len(width) - 1)
    h = width[i][:, None]
    left, right = (x[:, None] - _KNOTS[i][:, None]) / h, (_KNOTS[i + 1][:, None] - x[:, None]) / h
    values = unit[i] * right + unit[i + 1] * left
    values = values + h * h / 6.0 * (
        second[i] * (right**3 - right) + second[i + 1] * (left**3 - left)
    )
    return np.asarray(values[:, _FREE].T, dtype=np.float64)


_WAVE = (-5.73, -2.73, -1.09)
# Best two-dimensional C-start within larval curvatures of Gazzola et al. 2012, as in CubismUP 2D:
# the preparatory stroke bends the body into a C, the propulsive one unfolds it.
C_START = Strokes(
    sequence=(
        Stroke(duration=0.7, bend=(-3.19, -0.74, -0.44), wave=_WAVE, lag=0.74),
        Stroke(duration=1.0, bend=(0.0, 0.0, 0.0), wave=_WAVE, lag=0.74),
    ),
    phase=1.11,
)
