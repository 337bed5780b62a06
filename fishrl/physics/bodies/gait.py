"""How the midline beats: gaits, phase and the momentum-free frame.

The deformation is a vertical shear y -> y + Z(X, t), X measured from the head: area is conserved
exactly and the deformation velocity (0, Z_t) has no divergence. The travelling wave

    Z = L a(X/L) sin(k X/L - phase),  a(x) = A (c0 + c1 x + c2 x^2)

is the paper's eq. 11 with a minus sign: as printed, + w t, the wave would run from tail to head and
the fish would not swim forward. As Z = e1 S(X) + e2 C(X), every integral over the body that the
momentum-free frame needs is a constant times e1, e2 or their products. A bend of the midline is a
third such mode. ``midline.py`` has the other deformation, which keeps the midline's length.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, pi
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class Gait:
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

    @property
    def tail_speed(self) -> float:
        """Largest lateral speed of the tail, 2 pi a(1), in body lengths per tail-beat period."""
        return 2.0 * pi * float(self.evaluate_envelope(np.ones(1))[0])


# Anguilliform wave of Carling et al. 1998, as used by Kern & Koumoutsakos 2006 and Gazzola et al.
CARLING = Gait(amplitude=0.125 / 1.03125, envelope=(0.03125, 1.0, 0.0), wavenumber=2 * pi)
# Carangiform envelope of Videler & Hess 1984 (saithe), tail amplitude 0.1.
CARANGIFORM = Gait(amplitude=0.1, envelope=(0.2, -0.8, 1.6), wavenumber=2 * pi)
# The paper's k = 3 read as radians per body length, with Carling's envelope (the paper's is
# unsaid).
LONG_WAVE = Gait(amplitude=0.125 / 1.03125, envelope=(0.03125, 1.0, 0.0), wavenumber=3.0)
GAITS = {"carling": CARLING, "carangiform": CARANGIFORM, "long wave": LONG_WAVE}


class Shape(NamedTuple):
    """A body in its own frame, in lattice units; ``[B, ...]`` or ``[1, ...]``, float64.

    The frame's origin is the centre of area, its axis runs from nose to tail. A fish deforms by K
    modes Z = sum_k e_k Z_k(X): the gait's sine and cosine and the bend. Each mode is centred: its
    mean over the body's area is removed, so that deforming never moves the centre of mass.

    Attributes:
        axial: ``[B, N]`` place of each marker along the axis (constant).
        lateral: ``[B, N]`` place across it when the body is straight (constant).
        spacing: ``[B, N]`` length of outline that each marker stands for.
        modes: ``[B, K, N]`` Z_k at the markers.
        moments: ``[B, K]`` integral of m X Z_k, with m the thickness.
        gram: ``[B, K, K]`` integral of m Z_j Z_k.
        area: ``[B]`` of the body.
        inertia: ``[B]`` polar moment of area of the straight body about its centre.
        density_ratio: ``[B]`` body density over fluid density.
    """

    axial: Tensor
    lateral: Tensor
    spacing: Tensor
    modes: Tensor
    moments: Tensor
    gram: Tensor
    area: Tensor
    inertia: Tensor
    density_ratio: Tensor


def advance_phase(phase: Tensor, frequency: Tensor) -> Tensor:
    """Return the phase one step later; integrating it keeps Z continuous when f changes."""
    return torch.remainder(phase + 2.0 * pi * frequency, 2.0 * pi)


def compute_ramp(beats: Tensor, frequency: Tensor) -> tuple[Tensor, Tensor]:
    """Return the start-up amplitude sin(pi t / 2 T) for t < T, then 1, and its rate per step.

    ``beats`` = t / T are counted, so that the amplitude stays continuous when the frequency
    changes within the first beat.
    """
    beats = beats.clamp(max=1.0)
    rate = torch.where(beats < 1.0, 0.5 * pi * frequency, torch.zeros_like(frequency))
    return torch.sin(0.5 * pi * beats), rate * torch.cos(0.5 * pi * beats)


class Deformation(NamedTuple):
    """Outline and its velocity in the momentum-free frame, lattice units.

    Attributes:
        axial: ``[B, N]`` place of the markers along the body axis.
        lateral: ``[B, N]`` place across it.
        axial_velocity: ``[B, N]`` deformation velocity along the axis.
        lateral_velocity: ``[B, N]`` deformation velocity across it, Z_t - y_c,t.
        spin: ``[B]`` angular velocity -H / I of the body frame that makes the deformation free of
            angular momentum.
        inertia: ``[B]`` polar moment of area I of the deformed body.
        inertia_rate: ``[B]`` dI/dt.
    """

    axial: Tensor
    lateral: Tensor
    axial_velocity: Tensor
    lateral_velocity: Tensor
    spin: Tensor
    inertia: Tensor
    inertia_rate: Tensor


class Beat(NamedTuple):
    """What sets a fish's shape at one instant; every field ``[B]``.

    Attributes:
        phase: radians.
        frequency: tail beats per step.
        beats: tail beats since the fish began to swim.
        bend: kappa, of the bend kappa L x^2.
        bend_rate: its change per step.
    """

    phase: Tensor
    frequency: Tensor
    beats: Tensor
    bend: Tensor
    bend_rate: Tensor


def compute_amplitudes(beat: Beat) -> tuple[list[Tensor], list[Tensor]]:
    """Return the amplitudes ``[B]`` of the modes (sine, cosine, bend) and their rates per step."""
    ramp, ramp_rate = compute_ramp(beat.beats, beat.frequency)
    cos, sin, rate = torch.cos(beat.phase), torch.sin(beat.phase), 2.0 * pi * beat.frequency
    swing_rates = [ramp_rate * cos - ramp * rate * sin, -ramp_rate * sin - ramp * rate * cos]
    return [ramp * cos, -ramp * sin, beat.bend], [*swing_rates, beat.bend_rate]


def shear(shape: Shape, amplitudes: Sequence[Tensor]) -> Tensor:
    """Return the markers' place across the axis ``[B, N]`` at amplitudes ``[B]`` of the modes."""
    lateral = shape.lateral
    for j in range(shape.modes.shape[1]):
        lateral = lateral + shape.modes[:, j] * amplitudes[j][:, None]
    return lateral


def deform(shape: Shape, beat: Beat) -> Deformation:
    """Shear a body vertically by its modes, y -> y + Z(X, t).

    Args:
        shape: of the body; one mode (all zero) for a rigid one, three for a fish.
        beat: the instant.
    """
    e, e_t = compute_amplitudes(beat)
    lateral, velocity = shear(shape, e), torch.zeros_like(shape.lateral)
    inertia, inertia_rate = shape.inertia, torch.zeros_like(beat.phase)
    momentum = torch.zeros_like(beat.phase)
    for j in range(shape.modes.shape[1]):
        velocity = velocity + shape.modes[:, j] * e_t[j][:, None]
        momentum = momentum + shape.moments[:, j] * e_t[j]
        for k in range(shape.modes.shape[1]):
            inertia = inertia + shape.gram[:, j, k] * e[j] * e[k]
            inertia_rate = inertia_rate + 2.0 * shape.gram[:, j, k] * e[j] * e_t[k]
    still = torch.zeros_like(lateral)
    return Deformation(
        still + shape.axial, lateral, still, velocity, -momentum / inertia, inertia, inertia_rate
    )
