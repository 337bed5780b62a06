"""How the midline beats: gaits, phase and the momentum-free frame.

The deformation is a vertical shear y -> y + Z(X, t), X measured from the head: area is conserved
exactly and the deformation velocity (0, Z_t) has no divergence. The travelling wave

    Z = L a(X/L) sin(k X/L - phase),  a(x) = A (c0 + c1 x + c2 x^2)

is the paper's eq. 11 with a minus sign: as printed, + w t, the wave would run from tail to head and
the fish would not swim forward. As Z = e1 S(X) + e2 C(X), every integral over the body that the
momentum-free frame needs is a constant times e1, e2 or their products.
"""

from dataclasses import dataclass
from math import pi
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

    def evaluate_envelope(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a(x) in body lengths at ``x`` body lengths from the head."""
        c0, c1, c2 = self.envelope
        return self.amplitude * (c0 + c1 * x + c2 * x * x)

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


class Modes(NamedTuple):
    """The gait's two standing modes, resolved at the markers, in lattice units.

    S and C are centred: their mean over the body's area is removed, so the deformation never moves
    the centre of mass.

    Attributes:
        axial: ``[N]`` X - X_c of each marker (constant).
        lateral: ``[N]`` signed half-thickness of each marker (constant).
        sine: ``[N]`` S = L a sin(k x), centred.
        cosine: ``[N]`` C = L a cos(k x), centred.
        moment_sine: integral of m (X - X_c) S, with m the thickness; scalar.
        moment_cosine: integral of m (X - X_c) C.
        square_sine: integral of m S^2.
        square_cross: integral of m S C.
        square_cosine: integral of m C^2.
        area: of the body.
        inertia: polar moment of area of the straight body about its centre.
    """

    axial: Tensor
    lateral: Tensor
    sine: Tensor
    cosine: Tensor
    moment_sine: Tensor
    moment_cosine: Tensor
    square_sine: Tensor
    square_cross: Tensor
    square_cosine: Tensor
    area: Tensor
    inertia: Tensor


def advance_phase(phase: Tensor, frequency: Tensor) -> Tensor:
    """Return the phase one step later; integrating it keeps Z continuous when f changes."""
    return torch.remainder(phase + 2.0 * pi * frequency, 2.0 * pi)


def compute_ramp(age: Tensor, frequency: Tensor) -> tuple[Tensor, Tensor]:
    """Return the start-up amplitude sin(pi t / 2 T) for t < T, then 1, and its rate per step."""
    beats = (age * frequency).clamp(max=1.0)
    rate = torch.where(beats < 1.0, 0.5 * pi * frequency, torch.zeros_like(frequency))
    return torch.sin(0.5 * pi * beats), rate * torch.cos(0.5 * pi * beats)


class Deformation(NamedTuple):
    """Shape and shape velocity in the momentum-free frame, lattice units.

    Attributes:
        lateral: ``[B, N]`` lateral position of the markers in the body frame.
        lateral_velocity: ``[B, N]`` deformation velocity Z_t - y_c,t.
        spin: ``[B]`` angular velocity -H / I of the body frame that makes the deformation free of
            angular momentum.
        inertia: ``[B]`` polar moment of area I of the deformed body.
    """

    lateral: Tensor
    lateral_velocity: Tensor
    spin: Tensor
    inertia: Tensor


def deform(modes: Modes, phase: Tensor, frequency: Tensor, age: Tensor) -> Deformation:
    """Evaluate the deformation of all flows.

    Args:
        modes: of the gait.
        phase: ``[B]`` radians.
        frequency: ``[B]`` tail beats per step.
        age: ``[B]`` steps since the fish began to swim.
    """
    ramp, ramp_rate = compute_ramp(age, frequency)
    cos, sin, rate = torch.cos(phase), torch.sin(phase), 2.0 * pi * frequency
    e1, e2 = ramp * cos, -ramp * sin
    e1_t, e2_t = ramp_rate * cos - ramp * rate * sin, -ramp_rate * sin - ramp * rate * cos
    inertia = modes.inertia + (
        modes.square_sine * e1 * e1
        + 2.0 * modes.square_cross * e1 * e2
        + modes.square_cosine * e2 * e2
    )
    momentum = modes.moment_sine * e1_t + modes.moment_cosine * e2_t
    lateral = modes.lateral + modes.sine * e1[:, None] + modes.cosine * e2[:, None]
    velocity = modes.sine * e1_t[:, None] + modes.cosine * e2_t[:, None]
    return Deformation(lateral, velocity, -momentum / inertia, inertia)
