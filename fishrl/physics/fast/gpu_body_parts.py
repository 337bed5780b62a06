"""The bodies' parts of a step on a GPU, around the Triton kernels of ``triton_coupling.py``.

Each step places the markers, lets the kernels couple fluid and bodies, and moves the bodies.
Placing and moving are the functions that the readable step calls, compiled; the kernels replace
``step.couple_bodies`` and the spreading.
"""

import logging
from importlib.util import find_spec
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.fast.body_parts import (
    BODY_SETTINGS,
    Bodies,
    Places,
    find_places,
    get_bodies,
)
from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import Part, copy_tree
from fishrl.physics.flow import Coupling, FlowConfig
from fishrl.physics.geometry import BodyGeometry, locate_bodies
from fishrl.physics.immersed_boundary import IterativeForcing
from fishrl.physics.rigid_motion import move_body, report_bodies
from fishrl.physics.surface import prescribe_surface

logger = logging.getLogger(__name__)

# Largest number of markers times right-hand sides, which registers hold: at 512 markers there is
# room for five bodies that move and turn freely.
_MAX_ELEMENTS = 8192


def can_use_triton(config: FlowConfig, device: torch.device) -> bool:
    """Return whether Triton's kernels can couple the bodies; otherwise tensor operations do."""
    if device.type != "cuda" or not config.bodies:
        return False
    if problem := _find_problem(config):
        logger.info("tensor operations couple the bodies, not Triton: %s", problem)
    return problem is None


def _find_problem(config: FlowConfig) -> str | None:
    if find_spec("triton") is None:
        return "it is not installed"
    if not isinstance(config.force_solve, IterativeForcing):
        return f"its kernels have no {type(config.force_solve).__name__}"
    if config.coupling is not Coupling.IMPLICIT:
        return "its kernels couple implicitly"
    num_markers = sum(body.num_markers for body in config.bodies)
    size = _round_up(num_markers) * _round_up(_count_rows(config))
    if size > _MAX_ELEMENTS:
        return (
            f"{num_markers} markers and {_count_rows(config) - 1} degrees of freedom are too many"
        )
    return None


def _count_rows(config: FlowConfig) -> int:
    """Return one more than the number of degrees of freedom that the flow determines."""
    return 1 + sum(len(body.motion.free_axes) for body in config.bodies)


def _round_up(n: int) -> int:
    return 1 << (n - 1).bit_length()


class CouplingBuffers(NamedTuple):
    """Arguments and results of the kernels; see ``triton_coupling.couple_bodies_``."""

    surface: Tensor
    inertia: Tensor
    push: Tensor
    g: Tensor
    slip: Tensor
    mass: Tensor
    change: Tensor
    steps: Tensor


def make_buffers(spacing: Tensor, num_rows: int) -> CouplingBuffers:
    """Return zeros for markers of ``spacing`` ``[B, N]`` and ``num_rows`` right-hand sides R."""
    num_flows, num_markers = spacing.shape
    surface, steps = (spacing.new_zeros(num_flows, num_rows, 2, num_markers) for _ in range(2))
    g, slip = (spacing.new_zeros(num_flows, 2, num_markers) for _ in range(2))
    inertia, push, change = (
        spacing.new_zeros(num_flows, num_rows, dtype=torch.float64) for _ in range(3)
    )
    mass = torch.zeros_like(spacing)
    return CouplingBuffers(surface, inertia, push, g, slip, mass, change, steps)


def make_triton_parts(
    config: FlowConfig, layout: InPlaceLayout, geometry: BodyGeometry
) -> list[Part]:
    """Return the parts that place the markers, launch the kernels, and move the bodies.

    All groups share the memory of the ``geometry``. Bodies that stay still are located beforehand.
    """
    from fishrl.physics.fast.triton_coupling import couple_bodies_  # needs Triton

    solve, buffers = config.force_solve, make_buffers(geometry.spacing, _count_rows(config))
    places = find_places(layout, geometry.spacing.device)
    assert isinstance(solve, IterativeForcing)

    def collect(memory: GroupMemory, parity: int) -> tuple[Bodies, BodyGeometry, CouplingBuffers]:
        return get_bodies(memory), geometry, buffers

    def place(bodies: Bodies, geometry: BodyGeometry, buffers: CouplingBuffers) -> None:
        """Write the geometry and the kernels' right-hand sides."""
        kept = geometry
        if not config.is_still:
            geometry = locate_bodies(config, *bodies, torch.float32)
            copy_tree(kept, geometry)
        surface = prescribe_surface(
            config.bodies, config.coupling, *bodies, geometry.outlines, torch.float32
        )
        zero, one = torch.zeros_like(surface.velocity[:, 0]), torch.ones_like(buffers.push[:, 0])
        units = (
            torch.stack([zero if unit is None else unit for unit in each.unit], 1)
            for each in surface.freedoms
        )
        buffers.surface.copy_(torch.stack([surface.velocity, *units], 1))
        buffers.inertia.copy_(torch.stack([one, *(each.inertia for each in surface.freedoms)], -1))
        buffers.push.copy_(torch.stack([one, *(each.push for each in surface.freedoms)], -1))

    def collect_all(
        memory: GroupMemory, parity: int
    ) -> tuple[Places, Tensor, BodyGeometry, CouplingBuffers]:
        return places(memory, parity), memory.omega, geometry, buffers

    def couple(
        places: Places, omega: Tensor, geometry: BodyGeometry, buffers: CouplingBuffers
    ) -> None:
        # Triton launches on the current device
        with torch.cuda.device_of(omega):
            couple_bodies_(
                *places,
                omega,
                *geometry.stencil,
                geometry.spacing,
                geometry.operator[0],
                *buffers,
                row_length=layout.row_length,
                num_iterations=solve.num_iterations,
                relaxation=solve.relaxation,
                energy=config.rates.energy,
                scale=config.storage.scale,
            )

    def move(bodies: Bodies, geometry: BodyGeometry, buffers: CouplingBuffers) -> None:
        """Move the bodies by the kernels' results, and add to their totals."""
        (params, states), outlines = bodies, geometry.outlines
        force_x, force_y = (buffers.mass * g for g in buffers.g.unbind(1))
        slip_x, slip_y = buffers.slip.unbind(1)
        updates = report_bodies(
            states,
            outlines,
            prescribe_surface(config.bodies, config.coupling, *bodies, outlines, torch.float32),
            changes=buffers.change[:, 1:].unbind(-1),
            force=(force_x, force_y),
            slip=(slip_x, slip_y),
        )
        each = zip(config.bodies, params, states, outlines.deformations, updates, strict=True)
        copy_tree(states, tuple(move_body(*body) for body in each))

    return [
        Part("placement", collect, place, BODY_SETTINGS),
        Part("kernels", collect_all, couple, None),  # compiled at the first launch
        Part("motion", collect, move, BODY_SETTINGS),
    ]
