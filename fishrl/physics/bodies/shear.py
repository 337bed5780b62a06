"""Deformation by vertical shear: y -> y + Z(X, t), X measured along the straight axis.

Area is conserved exactly and the deformation velocity (0, Z_t) has no divergence. As Z is a sum of
modes e_k(t) Z_k(X), every integral over the body that the momentum-free frame needs is a constant
times the e_k or their products. ``midline.py`` has the other deformation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.gait import Deformation, compute_amplitude_rates, compute_amplitudes
from fishrl.physics.bodies.state import BodyState


class ShearParams(NamedTuple):
    """A body in its own frame, in lattice units; ``[B, ...]`` or ``[1, ...]``, float64.

    The frame's origin is the centre of area, its axis runs from nose to tail. A fish deforms by K
    modes: the gait's sine and cosine and the bend; a rigid body has one mode, which is zero. Each
    mode is centred: its mean over the body's area is removed, so that deforming never moves the
    centre of mass.
    """

    axial: Tensor  #: ``[B, N]`` coordinate of each marker along the axis (constant)
    lateral: Tensor  #: ``[B, N]`` coordinate across it when the body is straight (constant)
    spacing: Tensor  #: ``[B, N]`` length of outline that each marker represents
    modes: Tensor  #: ``[B, K, N]`` Z_k at the markers
    moments: Tensor  #: ``[B, K]`` integral of m X Z_k, with m the thickness
    gram: Tensor  #: ``[B, K, K]`` integral of m Z_j Z_k
    area: Tensor  #: ``[B]`` of the body
    inertia: Tensor  #: ``[B]`` polar moment of area of the straight body about its centre
    density_ratio: Tensor  #: ``[B]`` body density over fluid density

    def draw(self, body: BodyState) -> tuple[Tensor, Tensor]:
        """Return the markers along and across the axis ``[B, N]``, without their velocity."""
        return self.axial, self._sum_modes(compute_amplitudes(body))

    def deform(self, body: BodyState, bend_rate: Tensor) -> Deformation:
        """Return the outline and its velocity; ``bend_rate`` ``[B]`` is the bend's per step."""
        e, e_t = compute_amplitudes(body), compute_amplitude_rates(body, bend_rate)
        lateral, velocity = self._sum_modes(e), torch.zeros_like(self.lateral)
        inertia, inertia_rate = self.inertia, torch.zeros_like(body.phase)
        momentum = torch.zeros_like(body.phase)
        for j in range(self.modes.shape[1]):
            velocity = velocity + self.modes[:, j] * e_t[j][:, None]
            momentum = momentum + self.moments[:, j] * e_t[j]
            for k in range(self.modes.shape[1]):
                inertia = inertia + self.gram[:, j, k] * e[j] * e[k]
                inertia_rate = inertia_rate + 2.0 * self.gram[:, j, k] * e[j] * e_t[k]
        zero = torch.zeros_like(lateral)
        return Deformation(
            axial=zero + self.axial,
            lateral=lateral,
            axial_velocity=zero,
            lateral_velocity=velocity,
            spin=-momentum / inertia,
            inertia=inertia,
            inertia_rate=inertia_rate,
        )

    def _sum_modes(self, amplitudes: Sequence[Tensor]) -> Tensor:
        """Return the lateral coordinate ``[B, N]`` at amplitudes ``[B]`` of the modes."""
        lateral = self.lateral
        for j in range(self.modes.shape[1]):
            lateral = lateral + self.modes[:, j] * amplitudes[j][:, None]
        return lateral
