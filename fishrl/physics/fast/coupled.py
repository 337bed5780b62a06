"""The bodies' part of a step on a GPU: what surrounds the kernel of ``body_kernel.py``.

Each step places the markers, lets the kernel couple fluid and bodies, and moves the bodies. Placing
and moving are the functions that the readable step calls, compiled; the kernel stands for
``step.exchange`` and the spreading.
"""

import logging
from importlib.util import find_spec

import torch
from torch.utils import _pytree as pytree

from fishrl.physics.coupling import Surface, move_body, prescribe_surface, report_bodies
from fishrl.physics.fast.compiled import Kernel
from fishrl.physics.fast.kernels import BodyArguments, Exchange, copy_tree
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.flow import Coupling, FlowConfig
from fishrl.physics.geometry import BodyGeometry, locate_bodies
from fishrl.physics.immersed_boundary import IterativeForcing

logger = logging.getLogger(__name__)

# Largest number of markers times right-hand sides, which registers hold: at 512 markers there is
# room for five bodies that move and turn freely.
_MAX_ELEMENTS = 8192


def has_kernel(config: FlowConfig, device: torch.device) -> bool:
    """Return whether the kernel couples the bodies of such flows; else tensor operations do."""
    if device.type != "cuda" or not config.bodies:
        return False
    if problem := _find_problem(config):
        logger.info("the bodies are coupled by tensor operations, as %s", problem)
    return problem is None


def _find_problem(config: FlowConfig) -> str | None:
    if find_spec("triton") is None:
        return "Triton is not installed"
    if not isinstance(config.force_solve, IterativeForcing):
        return f"the kernel has no {type(config.force_solve).__name__}"
    if config.coupling is not Coupling.IMPLICIT:
        return "the kernel couples implicitly"
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


def make_exchange(config: FlowConfig, geometry: BodyGeometry) -> Exchange:
    """Return memory for what placing, kernel and moving hand each other."""
    spacing, num_rows = geometry.spacing, _count_rows(config)
    num_flows, num_markers = spacing.shape

    def per_marker(*shape: int) -> torch.Tensor:
        return spacing.new_zeros(num_flows, *shape, num_markers)

    def per_row() -> torch.Tensor:
        return spacing.new_zeros(num_flows, num_rows, dtype=torch.float64)

    return Exchange(
        surface=per_marker(num_rows, 2),
        inertia=per_row(),
        push=per_row(),
        g=per_marker(2),
        slip=per_marker(2),
        mass=per_marker(),
        change=per_row(),
        steps=per_marker(num_rows, 2),
    )


def make_place(config: FlowConfig, form: pytree.TreeSpec) -> Kernel:
    """Return: place the markers and say how they move, and how they would if the flow moved them.

    Bodies that stay still were located before.
    """

    def place(*leaves: torch.Tensor) -> None:
        call: BodyArguments = pytree.tree_unflatten(leaves, form)
        geometry, exchange = call.geometry, call.exchange
        assert geometry and exchange
        if not config.is_still:
            geometry = locate_bodies(config, call.params, call.bodies, torch.float32)
            copy_tree(call.geometry, geometry)
        surface = prescribe_surface(config, call.params, call.bodies, geometry, torch.float32)
        one = torch.ones_like(exchange.push[:, 0])
        freedoms = surface.freedoms
        exchange.surface.copy_(_stack_rows(surface))
        exchange.inertia.copy_(torch.stack([one, *(each.inertia for each in freedoms)], -1))
        exchange.push.copy_(torch.stack([one, *(each.push for each in freedoms)], -1))

    return place


def _stack_rows(surface: Surface) -> torch.Tensor:
    """Return the velocity of the markers and what each freedom adds to it, ``[B, R, 2, N]``."""
    zero = torch.zeros_like(surface.velocity[:, 0])
    units = (
        torch.stack([zero if unit is None else unit for unit in each.unit], 1)
        for each in surface.freedoms
    )
    return torch.stack([surface.velocity, *units], 1)


def make_couple(config: FlowConfig, layout: InPlaceLayout, form: pytree.TreeSpec) -> Kernel:
    """Return: couple fluid and bodies by the kernel."""
    from fishrl.physics.fast.body_kernel import couple_bodies  # needs Triton

    solve = config.force_solve
    assert isinstance(solve, IterativeForcing)

    def couple(*leaves: torch.Tensor) -> None:
        call: BodyArguments = pytree.tree_unflatten(leaves, form)
        assert call.geometry and call.exchange
        # Triton launches on the current device
        with torch.cuda.device_of(call.data):  # type: ignore[no-untyped-call]
            couple_bodies(
                call.data,
                call.offsets,
                call.first_cell,
                call.omega,
                *call.geometry.stencil,
                call.geometry.spacing,
                call.geometry.operator[0],
                *call.exchange,
                row_length=layout.row_length,
                num_iterations=solve.num_iterations,
                relaxation=solve.relaxation,
                energy=config.rates.energy,
                scale=config.storage.value[1],
            )

    return couple


def make_move(config: FlowConfig, form: pytree.TreeSpec) -> Kernel:
    """Return: move the bodies as the kernel found, and count up their totals."""

    def move(*leaves: torch.Tensor) -> None:
        call: BodyArguments = pytree.tree_unflatten(leaves, form)
        geometry, exchange = call.geometry, call.exchange
        assert geometry and exchange
        updates = report_bodies(
            config,
            call.bodies,
            geometry,
            prescribe_surface(config, call.params, call.bodies, geometry, torch.float32),
            changes=exchange.change[:, 1:].unbind(-1),
            mass=exchange.mass,
            g=exchange.g.unbind(1),
            slip=exchange.slip.unbind(1),
        )
        bodies = zip(
            config.bodies, call.params, call.bodies, geometry.deformations, updates, strict=True
        )
        copy_tree(call.bodies, tuple(move_body(*body) for body in bodies))

    return move
