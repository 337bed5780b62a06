"""Gaits: how a fish's midline beats, and the deformation that follows.

The travelling wave

    Z = L a(X/L) sin(k X/L - phase),  a(x) = A (c0 + c1 x + c2 x^2)

is the paper's eq. 11 with a constant c0 and a minus sign: as printed, + w t, the wave would run
from tail to head and the fish would not swim forward. Z = e1 S(X) + e2 C(X) has two modes; a bend
of the midline is a third. ``shear.py`` and ``midline.py`` turn them into an outline.
"""

from functools import cached_property
from math import comb, pi
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fishrl.physics.bodies.state import BodyState
from fishrl.settings import Settings


class Gait(Settings):
    """Amplitude envelope and wavenumber of a swimming gait.

    Args:
        amplitude: A, tail amplitude in body lengths where c0 + c1 + c2 = 1.
        envelope: (c0, c1, c2).
        wavenumber: k in radians per body length; the body wave is 2 pi / k body lengths long.
    """

    amplitude: float
    envelope: tuple[float, float, float]
    wavenumber: float

    def evaluate_envelope(self, x: NDArray[np.float64], order: int = 0) -> NDArray[np.float64]:
        """Return a(x), or a derivative of it, in body lengths at ``x`` from the head."""
        polynomial = np.polynomial.Polynomial(self.envelope).deriv(order)
        return np.asarray(self.amplitude * polynomial(x), dtype=np.float64)

    def evaluate_modes(self, x: NDArray[np.float64], order: int = 0) -> NDArray[np.float64]:
        """Return a sin kx, a cos kx and the bend x^2, or derivatives, ``[3, n]``, body lengths."""
        k = self.wavenumber
        waves = []
        for shift in (0.0, 0.5 * pi):
            terms = (
                comb(order, j)
                * self.evaluate_envelope(x, j)
                * k ** (order - j)
                * np.sin(k * x + shift + 0.5 * pi * (order - j))
                for j in range(order + 1)
            )
            waves.append(sum(terms, np.zeros_like(x)))
        return np.stack([*waves, np.polynomial.Polynomial((0.0, 0.0, 1.0)).deriv(order)(x)])

    @cached_property
    def tail_speed(self) -> float:
        """Largest lateral speed, 2 pi times the largest amplitude, in L per tail-beat period.

        For an envelope that is largest at the tail, it is the tail's speed.
        """
        turning = np.polynomial.Polynomial(self.envelope).deriv().roots().real
        places = np.array([0.0, 1.0, *turning]).clip(0.0, 1.0)
        return 2.0 * pi * float(np.abs(self.evaluate_envelope(places)).max())


# Anguilliform wave of Carling et al. 1998, as used by Kern & Koumoutsakos 2006 and Gazzola et al.
CARLING = Gait(amplitude=0.125 / 1.03125, envelope=(0.03125, 1.0, 0.0), wavenumber=2 * pi)
# Carangiform envelope of Videler & Hess 1984 (saithe), tail amplitude 0.1.
CARANGIFORM = Gait(amplitude=0.1, envelope=(0.2, -0.8, 1.6), wavenumber=2 * pi)
# The paper's k = 3 read as radians per body length, with Carling's envelope (the paper gives none).
LONG_WAVE = Gait(amplitude=0.125 / 1.03125, envelope=(0.03125, 1.0, 0.0), wavenumber=3.0)
GAITS = {"carling": CARLING, "carangiform": CARANGIFORM, "long wave": LONG_WAVE}


def advance_phase(phase: Tensor, frequency: Tensor) -> Tensor:
    """Return the phase one step later; integrating it keeps Z continuous when f changes."""
    return torch.remainder(phase + 2.0 * pi * frequency, 2.0 * pi)


def compute_ramp(beats: Tensor) -> Tensor:
    """Return the start-up amplitude sin(pi t / 2 T) for t < T, then 1.

    ``beats`` = t / T are counted, so that the amplitude stays continuous when the frequency
    changes within the first beat.
    """
    return torch.sin(0.5 * pi * beats.clamp(max=1.0))


def compute_ramp_rate(beats: Tensor, frequency: Tensor) -> Tensor:
    """Return the change per step of ``compute_ramp``."""
    beats = beats.clamp(max=1.0)
    rate = torch.where(beats < 1.0, 0.5 * pi * frequency.abs(), torch.zeros_like(frequency))
    return rate * torch.cos(0.5 * pi * beats)


class Deformation(NamedTuple):
    """An outline and its velocity in the momentum-free frame, lattice units."""

    axial: Tensor  #: ``[B, N]`` coordinate of the markers along the body axis
    lateral: Tensor  #: ``[B, N]`` coordinate across it
    axial_velocity: Tensor  #: ``[B, N]`` deformation velocity along the axis
    lateral_velocity: Tensor  #: ``[B, N]`` deformation velocity across it, Z_t - y_c,t
    #: ``[B]`` angular velocity -H / I of the body frame that makes the deformation free of angular
    #: momentum
    spin: Tensor
    inertia: Tensor  #: ``[B]`` polar moment of area I of the deformed body
    inertia_rate: Tensor  #: ``[B]`` dI/dt


def compute_amplitude_rate(body: BodyState) -> Tensor:
    """Return the change per step of a fish's amplitude ``[B]``.

    The amplitude relaxes to the commanded one with two time constants in the length of a command.
    """
    return (body.amplitude_goal - body.amplitude) * 2.0 / body.turn_steps.clamp_min(2.0)


def compute_amplitudes(body: BodyState) -> list[Tensor]:
    """Return the amplitudes ``[B]`` of the modes: sine, cosine, bend."""
    swing = body.amplitude * compute_ramp(body.beats)
    return [swing * torch.cos(body.phase), -swing * torch.sin(body.phase), body.bend]


def compute_amplitude_rates(body: BodyState, bend_rate: Tensor) -> list[Tensor]:
    """Return the change per step of ``compute_amplitudes``; ``bend_rate`` ``[B]`` is the bend's."""
    ramp, ramp_rate = compute_ramp(body.beats), compute_ramp_rate(body.beats, body.frequency)
    swing = body.amplitude * ramp
    swing_rate = body.amplitude * ramp_rate + compute_amplitude_rate(body) * ramp
    cos, sin, rate = torch.cos(body.phase), torch.sin(body.phase), 2.0 * pi * body.frequency
    return [
        swing_rate * cos - swing * rate * sin,
        -swing_rate * sin - swing * rate * cos,
        bend_rate,
    ]
