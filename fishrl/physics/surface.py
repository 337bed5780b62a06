"""How the bodies' surfaces move, and the rigid degrees of freedom that the flow determines."""

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.flow import Coupling
from fishrl.physics.geometry import Outlines

Pair = tuple[Tensor | None, Tensor | None]


class Freedom(NamedTuple):
    """One rigid degree of freedom that the flow determines."""

    body: int  #: index of its body
    axis: int  #: 0 and 1 for the centre of mass along x and y, 2 for turning
    unit: Pair  #: velocity (x, y) that a unit of it gives all markers, ``[B, N]``; None is zero
    rows: tuple[int | None, int | None]  #: rows of the force solve that hold its right-hand sides
    #: ``[B]`` mass or moment of inertia; the immersed boundary leaves out the fluid's inside
    inertia: Tensor
    push: Tensor  #: ``[B]`` force or torque in addition to the fluid's

    def respond(self, solution: Tensor) -> Pair:
        """Return the rows (x, y) of a solution ``[B, R, N]`` that a unit of it causes."""
        x, y = self.rows
        return None if x is None else solution[:, x], None if y is None else solution[:, y]


class Surface(NamedTuple):
    """How the bodies' surface moves if the flow changes no rate, and what it may change."""

    #: (U_x, U_y, Omega) ``[B]`` of each body: prescribed, or as in the last step
    rates: list[list[Tensor]]
    velocity: Tensor  #: ``[B, 2, N]`` of the markers at these rates
    freedoms: list[Freedom]  #: rates that the flow determines
    units: list[Tensor]  #: ``[B, N]`` right-hand sides of the force solve for the freedoms


def prescribe_surface(
    bodies: Sequence[BodyConfig],
    coupling: Coupling,
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    outlines: Outlines,
    dtype: torch.dtype,
) -> Surface:
    """Return the motion of all markers with the rates prescribed, or as in the last step.

    ``outlines`` are those of the ``bodies`` now; velocities are of ``dtype``. The ``coupling``
    decides whether the inertia of the freedoms leaves out the fluid inside.
    """
    own = slice_markers(outlines)
    num_markers = own[-1].stop
    displaced = 1.0 if coupling is Coupling.IMPLICIT else 0.0

    def widen(values: Tensor, m: int) -> Tensor:
        """Return values of body m at all markers, zero at the markers of the others."""
        return pad(values, (own[m].start, num_markers - own[m].stop)) if len(own) > 1 else values

    rates: list[list[Tensor]] = []
    velocities: list[Tensor] = []
    freedoms: list[Freedom] = []
    units: list[Tensor] = []
    for m, (body, state) in enumerate(zip(bodies, states, strict=True)):
        markers, deformation, motion = outlines.markers[m], outlines.deformations[m], body.motion
        linear, omega = motion.prescribe(state)
        own_rates = [*linear.unbind(-1), omega]
        last = *state.velocity.unbind(-1), state.angular_velocity
        for axis in motion.free_axes:
            own_rates[axis] = last[axis]
        rates.append(own_rates)
        linear, omega = torch.stack(own_rates[:2], -1), own_rates[2]
        spin = torch.stack((-markers.arm[..., 1], markers.arm[..., 0]), -1) * omega[:, None, None]
        velocities.append((linear[:, None] + spin + markers.deformation_velocity).to(dtype).mT)
        rx, ry = (arm.to(dtype) for arm in markers.arm.unbind(-1))
        excess = params[m].density_ratio - displaced
        row = 2 + len(units)  # the first two rows are the slip itself
        shifts = [axis for axis in motion.free_axes if axis < 2]
        if shifts:
            one, mass = widen(torch.ones_like(rx), m), excess * params[m].area
            units.append(one)
            for axis in shifts:
                unit, rows = ((one, None), (row, None)) if axis == 0 else ((None, one), (None, row))
                freedoms.append(Freedom(m, axis, unit, rows, mass, state.load[:, axis]))
            row += 1
        if 2 in motion.free_axes:
            turning = widen(-ry, m), widen(rx, m)
            units += turning
            inertia = excess * deformation.inertia
            push = -(excess * deformation.inertia_rate * state.angular_velocity)
            freedoms.append(Freedom(m, 2, turning, (row, row + 1), inertia, push))
    return Surface(rates, torch.cat(velocities, -1), freedoms, units)


def slice_markers(outlines: Outlines) -> list[slice]:
    """Return where the markers of each body are among all."""
    numbers = [markers.position.shape[1] for markers in outlines.markers]
    return [slice(end - n, end) for end, n in zip(accumulate(numbers), numbers, strict=True)]
