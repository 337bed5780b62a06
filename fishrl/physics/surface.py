"""How a body's surface moves, and the rigid degrees of freedom that the flow determines."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.geometry import Outline, compute_velocity


class Freedom(NamedTuple):
    """One rigid degree of freedom of a body that the flow determines."""

    axis: int  #: 0 and 1 for the centre of mass along x and y, 2 for turning
    #: velocity that a unit of it gives the markers along x and y, ``[B, N]``; None is zero
    unit: tuple[Tensor | None, Tensor | None]
    inertia: Tensor  #: ``[B]`` mass or moment of inertia that the skin does not move by itself
    push: Tensor  #: ``[B]`` force or torque in addition to the fluid's


class Surface(NamedTuple):
    """How a body's surface moves if the flow changes no rate, and what it may change."""

    rates: list[Tensor]  #: (U_x, U_y, Omega) ``[B]``: prescribed, or as in the last step
    velocity: Tensor  #: ``[B, 2, N]`` of the markers at these rates
    freedoms: list[Freedom]  #: rates that the flow determines


def prescribe_surface(
    body: BodyConfig,
    params: BodyParams,
    state: BodyState,
    outline: Outline,
    dtype: torch.dtype,
    *,
    has_water_inside: bool,
) -> Surface:
    """Return the motion of a body's markers with the rates prescribed, or as in the last step.

    Velocities are of ``dtype``; see ``Skin.has_water_inside``.
    """
    markers, deformation, motion = outline.markers, outline.deformation, body.motion
    linear, omega = motion.prescribe(state)
    rates = [*linear.unbind(-1), omega]
    last = *state.velocity.unbind(-1), state.angular_velocity
    for axis in motion.free_axes:
        rates[axis] = last[axis]
    velocity = compute_velocity(markers, torch.stack(rates[:2], -1), rates[2]).to(dtype).mT
    rx, ry = (arm.to(dtype) for arm in markers.arm.unbind(-1))
    excess = params.density_ratio - (1.0 if has_water_inside else 0.0)
    one = torch.ones_like(rx)
    units = (one, None), (None, one), (-ry, rx)
    inertia = excess * params.area, excess * params.area, excess * deformation.inertia
    drag = excess * deformation.inertia_rate * state.angular_velocity
    push = *state.load.unbind(-1), -drag
    freedoms = [Freedom(axis, units[axis], inertia[axis], push[axis]) for axis in motion.free_axes]
    return Surface(rates, velocity, freedoms)


def eliminate(matrix: Sequence[Sequence[Tensor | float]], right: Sequence[Tensor]) -> list[Tensor]:
    """Solve a small system of ``[B]`` tensors; plain zeros in ``matrix`` cost nothing.

    Elimination without pivoting: the matrix is added mass plus excess mass, positive definite.
    """
    rows, values = [list(row) for row in matrix], list(right)
    size = len(values)
    for k in range(size):
        for i in range(k + 1, size):
            if not _is_zero(rows[i][k]):
                factor = rows[i][k] / rows[k][k]
                for j in range(k + 1, size):
                    if not _is_zero(rows[k][j]):
                        rows[i][j] = rows[i][j] - factor * rows[k][j]
                values[i] = values[i] - factor * values[k]
    for i in reversed(range(size)):
        for j in range(i + 1, size):
            if not _is_zero(rows[i][j]):
                values[i] = values[i] - rows[i][j] * values[j]
        values[i] = values[i] / rows[i][i]
    return values


def _is_zero(entry: Tensor | float) -> bool:
    return not isinstance(entry, Tensor) and entry == 0.0
