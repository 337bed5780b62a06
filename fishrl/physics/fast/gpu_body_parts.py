"""The bodies' parts of a step on a GPU, around the Triton kernels of ``triton_coupling.py``.

Each step places the markers, lets the kernels couple fluid and bodies, and moves the bodies.
Placing and moving are the functions that the readable step calls, compiled; the kernels replace
``step.couple_bodies`` and the spreading.
"""

import logging
from collections.abc import Sequence
from importlib.util import find_spec
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.fast.body_parts import BODY_SETTINGS, BODY_TITLE, MarkerCells
from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import Part, copy_tree
from fishrl.physics.flow import Coupling, FlowConfig
from fishrl.physics.geometry import BodyGeometry, locate_bodies
from fishrl.physics.immersed_boundary import IterativeForcing
from fishrl.physics.rigid_motion import move_body, report_bodies
from fishrl.physics.surface import Surface, prescribe_surface

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

    @classmethod
    def make(cls, config: FlowConfig, geometry: BodyGeometry) -> "CouplingBuffers":
        """Return zeros of the shapes that flows and bodies need."""
        spacing, num_rows = geometry.spacing, _count_rows(config)
        num_flows, num_markers = spacing.shape

        def per_marker(*shape: int) -> Tensor:
            return spacing.new_zeros(num_flows, *shape, num_markers)

        def per_row() -> Tensor:
            return spacing.new_zeros(num_flows, num_rows, dtype=torch.float64)

        return cls(
            surface=per_marker(num_rows, 2),
            inertia=per_row(),
            push=per_row(),
            g=per_marker(2),
            slip=per_marker(2),
            mass=per_marker(),
            change=per_row(),
            steps=per_marker(num_rows, 2),
        )


class MotionTensors(NamedTuple):
    """The bodies, and memory that all groups share."""

    params: tuple[BodyParams, ...]
    bodies: tuple[BodyState, ...]
    geometry: BodyGeometry
    buffers: CouplingBuffers


class _MotionPart(Part[MotionTensors]):
    """A part that reads or writes the bodies; ``geometry`` and ``buffers`` are the parts' own."""

    title = BODY_TITLE
    settings = BODY_SETTINGS

    def __init__(
        self, config: FlowConfig, geometry: BodyGeometry, buffers: CouplingBuffers
    ) -> None:
        super().__init__()
        self._config, self._geometry, self._buffers = config, geometry, buffers

    def collect(self, memory: GroupMemory, parity: int) -> MotionTensors:
        """Return the same at even and odd steps."""
        flow = memory.flow
        return MotionTensors(flow.params.bodies, flow.bodies, self._geometry, self._buffers)


class PlaceMarkers(_MotionPart):
    """Place the markers, and find how they move and how each degree of freedom would move them.

    Bodies that stay still are located beforehand, by ``LocateStill``.
    """

    def act(self, tensors: MotionTensors) -> None:
        """Write the geometry and the kernels' right-hand sides."""
        params, bodies, geometry, buffers = tensors
        if not self._config.is_still:
            geometry = locate_bodies(self._config, params, bodies, torch.float32)
            copy_tree(tensors.geometry, geometry)
        surface = prescribe_surface(self._config, params, bodies, geometry.outlines, torch.float32)
        one, freedoms = torch.ones_like(buffers.push[:, 0]), surface.freedoms
        buffers.surface.copy_(_stack_rows(surface))
        buffers.inertia.copy_(torch.stack([one, *(each.inertia for each in freedoms)], -1))
        buffers.push.copy_(torch.stack([one, *(each.push for each in freedoms)], -1))


def _stack_rows(surface: Surface) -> Tensor:
    """Return the velocity of the markers and what each freedom adds to it, ``[B, R, 2, N]``."""
    zero = torch.zeros_like(surface.velocity[:, 0])
    units = (
        torch.stack([zero if unit is None else unit for unit in each.unit], 1)
        for each in surface.freedoms
    )
    return torch.stack([surface.velocity, *units], 1)


class TritonTensors(NamedTuple):
    """What the kernels read and write; see ``body_parts.CoupleTensors``."""

    data: Tensor
    offsets: Tensor
    first_cell: Tensor
    omega: Tensor
    geometry: BodyGeometry
    buffers: CouplingBuffers


class CoupleByTriton(Part[TritonTensors]):
    """Couple fluid and bodies by kernels that Triton compiles."""

    title = BODY_TITLE

    def __init__(
        self,
        config: FlowConfig,
        layout: InPlaceLayout,
        geometry: BodyGeometry,
        buffers: CouplingBuffers,
    ) -> None:
        from fishrl.physics.fast.triton_coupling import couple_bodies_  # needs Triton

        super().__init__()
        self._couple_bodies_ = couple_bodies_
        self._config, self._row_length = config, layout.row_length
        self._geometry, self.buffers = geometry, buffers
        self._cells = MarkerCells(layout, geometry.spacing.device)

    def collect(self, memory: GroupMemory, parity: int) -> TritonTensors:
        """Return the populations of the group, and the memory that groups share."""
        return TritonTensors(
            data=memory.populations,
            offsets=self._cells.offsets[parity],
            first_cell=self._cells.first_cell,
            omega=memory.omega,
            geometry=self._geometry,
            buffers=self.buffers,
        )

    def act(self, tensors: TritonTensors) -> None:
        """Launch the kernels."""
        data, offsets, first_cell, omega, geometry, buffers = tensors
        solve = self._config.force_solve
        assert isinstance(solve, IterativeForcing)
        # Triton launches on the current device
        with torch.cuda.device_of(data):
            self._couple_bodies_(
                data,
                offsets,
                first_cell,
                omega,
                *geometry.stencil,
                geometry.spacing,
                geometry.operator[0],
                *buffers,
                row_length=self._row_length,
                num_iterations=solve.num_iterations,
                relaxation=solve.relaxation,
                energy=self._config.rates.energy,
                scale=self._config.storage.scale,
            )

    def compile(self, example: Sequence[Tensor], key: str | None) -> None:
        """Leave it to Triton, at the first launch."""


class MoveBodies(_MotionPart):
    """Move the bodies by the kernels' results, and add to their totals."""

    def act(self, tensors: MotionTensors) -> None:
        """Write the bodies' states."""
        config, (params, bodies, geometry, buffers) = self._config, tensors
        outlines = geometry.outlines
        force_x, force_y = (buffers.mass * g for g in buffers.g.unbind(1))
        slip_x, slip_y = buffers.slip.unbind(1)
        updates = report_bodies(
            config,
            bodies,
            outlines,
            prescribe_surface(config, params, bodies, outlines, torch.float32),
            changes=buffers.change[:, 1:].unbind(-1),
            force=(force_x, force_y),
            slip=(slip_x, slip_y),
        )
        each = zip(config.bodies, params, bodies, outlines.deformations, updates, strict=True)
        copy_tree(bodies, tuple(move_body(*body) for body in each))
