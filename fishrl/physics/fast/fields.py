"""Fields of flows at all nodes of the finest level, each of the finest grid there."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from fishrl.physics.boundaries import Periodic
from fishrl.physics.diagnostics import compute_vorticity
from fishrl.physics.fast.grid import Grid
from fishrl.physics.flow import FlowConfig
from fishrl.physics.levels.patch import RING


def lay_together(
    grids: Sequence[Grid],
    corners: Sequence[Tensor],
    config: FlowConfig,
    read: Callable[[Grid, Tensor], Tensor],
) -> Tensor:
    """Return values ``[N, C, Y, X]``; between the nodes of coarser grids they are linear.

    Args:
        grids: of the flows.
        corners: ``[N, 2]`` int64 of each, its first node in finest nodes.
        config: configuration of the flows.
        read: returns the values ``[N, C, Y, X]`` of a grid, given its corners ``[N, 2]``.
    """
    edges, (root, *patches) = config.boundaries, grids
    wraps = isinstance(edges.left, Periodic), isinstance(edges.bottom, Periodic)
    field = pad(read(root, corners[0]), (0, int(wraps[0]), 0, int(wraps[1])), mode="circular")
    field = _refine(field, root.level.spacing)[:, :, : config.height, : config.width]
    for grid, corner in zip(patches, corners[1:], strict=True):
        spacing, inside = grid.level.spacing, slice(RING, -RING)
        own = _refine(read(grid, corner)[:, :, inside, inside], spacing)
        for row, (x, y) in enumerate((corner + RING * spacing).tolist()):
            field[row, :, y : y + own.shape[2], x : x + own.shape[3]] = own[row]
    return field


def read_fluid(grid: Grid, rows: Tensor | None) -> Tensor:
    """Return density and velocity ``[N, 3, Y, X]`` of flows ``rows`` ``[B]``."""
    fluid = grid.read(rows)
    return torch.stack((fluid.rho, fluid.ux, fluid.uy), 1)


def read_vorticity(
    grid: Grid, corner: Tensor, rows: Tensor | None, is_water: Tensor | None
) -> Tensor:
    """Return the vorticity ``[N, 1, Y, X]`` of flows ``rows`` ``[B]``, per finest step.

    ``is_water`` ``[N, Y, X]`` is of the nodes of the finest level.
    """
    u, water = read_fluid(grid, rows)[:, 1:], None
    if is_water is not None and grid.level.spacing == 1:  # bodies are in the finest grids
        width, height = grid.level.frame.size
        water = is_water.new_empty(len(u), height, width)
        for own, every, (x, y) in zip(water, is_water, corner.tolist(), strict=True):
            own.copy_(every[y : y + height, x : x + width])
    return compute_vorticity(u, is_water=water)[:, None] / grid.level.spacing


def _refine(values: Tensor, factor: int) -> Tensor:
    """Return values ``[N, C, Y, X]`` at ``factor`` times as many nodes, linear between theirs."""
    height, width = (factor * (n - 1) + 1 for n in values.shape[-2:])
    if factor == 1:
        return values.clone()
    return interpolate(values, size=(height, width), mode="bilinear", align_corners=True)
