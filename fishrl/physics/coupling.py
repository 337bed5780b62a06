"""Coupling of the bodies' rigid motion to the flow.

Marker l sits at x_l = X + R(angle) (axial, lateral) and moves with V_l = U + (Omega - H/I) z x
r_l + R u_deform. Fluid and bodies are solved together: with the force solve written as a linear map
P, g = P (U_d - U*) is linear in every body's (U, Omega), so the new rigid velocities follow from
one small system and the momentum that a body gains is exactly what the fluid loses. At equal
density the body's mass cancels against the fluid inside it and the skin is force-free; with the
force of the last step, as the paper writes it, the motion is unstable there (added mass).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import BodyGeometry
from fishrl.physics.rigid_motion import RigidUpdate, report_bodies
from fishrl.physics.surface import Freedom, Pair, prescribe_surface, slice_markers


def solve_body_force(
    config: FlowConfig,
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    geometry: BodyGeometry,
    velocity: Tensor,
    rho: Tensor,
) -> tuple[Tensor, list[RigidUpdate]]:
    """Find the marker force and the new rigid velocities of all bodies together.

    Args:
        config: configuration of the flows; ``force_solve`` is P.
        params: parameters of each body.
        states: state of each body at the start of the step.
        geometry: geometry of the bodies at this step.
        velocity: ``[B, 2, N]`` unforced fluid velocity at the markers.
        rho: ``[B, N]`` fluid density at the markers.

    Returns:
        g ``[B, 2, N]``, with F = 2 rho g per unit length, and an update per body.
    """
    mass = 2.0 * rho * geometry.spacing  # of the fluid that the force acts on: F = mass g
    surface = prescribe_surface(
        config.bodies, config.coupling, params, states, geometry.outlines, velocity.dtype
    )
    residual = surface.velocity - velocity
    right = torch.stack([*residual.unbind(1), *surface.units], 1)
    solution, rest = config.force_solve(geometry.operator, right)
    own = slice_markers(geometry.outlines)

    def project(freedom: Freedom, g: Pair) -> Tensor | float:
        """Return the force or torque ``[B]`` along a degree of freedom that g puts on the fluid."""
        pairs = zip(freedom.unit, g, strict=True)
        parts = [unit * value for unit, value in pairs if unit is not None and value is not None]
        if not parts:
            return 0.0
        work = mass * sum(parts[1:], parts[0])
        return work[:, own[freedom.body]].sum(-1).double()

    # Newton's second law: (inertia + added mass) dU = -F + push. The added mass is the force that
    # dU itself causes, the projection of the other rows of the force solve.
    matrix = [
        [project(i, j.respond(solution)) + (i.inertia if i is j else 0.0) for j in surface.freedoms]
        for i in surface.freedoms
    ]
    slip_force = solution[:, 0], solution[:, 1]
    drive = [-project(free, slip_force) + free.push for free in surface.freedoms]
    changes = eliminate(matrix, drive)
    g, slip = list(solution[:, :2].unbind(1)), list(rest[:, :2].unbind(1))
    for freedom, change in zip(surface.freedoms, changes, strict=True):
        weight = change.to(velocity.dtype)[:, None]
        for values, rows in ((g, solution), (slip, rest)):
            for axis, response in enumerate(freedom.respond(rows)):
                if response is not None:
                    values[axis] = values[axis] + weight * response
    updates = report_bodies(
        states,
        geometry.outlines,
        surface,
        changes=changes,
        force=(mass * g[0], mass * g[1]),
        slip=(slip[0], slip[1]),
    )
    return torch.stack(g, 1), updates


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
