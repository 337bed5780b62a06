"""One grid of a batch of flows with levels, and its place among the others."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from fishrl.physics.boundaries import Periodic
from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.fast.part import Part
from fishrl.physics.fast.transfer_parts import Moving, PatchMemory
from fishrl.physics.flow import FlowConfig
from fishrl.physics.levels.grids import Level
from fishrl.physics.levels.patch import RING


@dataclass(eq=False)
class Grid:
    """One grid of all flows, and what passes between it and its parent."""

    level: Level
    batch: FlowBatch
    origin: Tensor  #: ``[B, 2]`` int64, of a patch in its parent; the root's is 0
    last: Tensor  #: ``[2]`` float64, (x, y) of the last node in its own nodes
    parent: "Grid | None"
    inside: list["Grid"] = field(default_factory=list)
    transfers: tuple[Part, ...] = ()  #: filling, restriction in each step, and that of all nodes

    def walk(self) -> Iterator["Grid"]:
        """Yield this grid and all inside it, coarser ones first."""
        yield self
        for patch in self.inside:
            yield from patch.walk()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in its own nodes."""
        return self.level.frame.size

    def find_corner(self) -> Tensor:
        """Return the place ``[B, 2]`` of the first node, in nodes of the finest level."""
        if self.parent is None:
            return self.origin
        return self.parent.find_corner() + self.parent.level.spacing * self.origin

    def bind(self, part: Part, number: int) -> tuple[Sequence[Tensor], Sequence[Tensor]]:
        """Return a transfer's arguments for a group, before even and odd steps of the parent."""
        assert self.parent is not None
        origin = self.origin[self.batch.rows_of(number)]
        parent = self.parent.batch.memory_of(number)
        return part.bind(PatchMemory(self.batch.memory_of(number), parent, origin))


def find_moving(grid: Grid, number: int, by: Tensor) -> Moving:
    """Return a group's patch that follows a body, and moves by ``by`` ``[B, 2]``."""
    own = grid.batch.memory_of(number)
    origin = grid.origin[grid.batch.rows_of(number)]
    return Moving(own.incoming(0), origin, by, own.flow.bodies)


def read_fluid(grid: Grid) -> Tensor:
    """Return density and velocity of a grid ``[B, 3, Y, X]``."""
    rho, u = grid.batch.macroscopic()
    return torch.cat((rho[:, None], u), 1)


def read_vorticity(grid: Grid, *, is_water: Tensor | None = None) -> Tensor:
    """Return the vorticity of a grid ``[B, 1, Y, X]`` per step of the finest level.

    ``is_water`` ``[B, Y, X]`` is of the nodes of the finest level.
    """
    spacing, (width, height) = grid.level.spacing, grid.size
    if is_water is None or spacing > 1:  # bodies are in the finest grids
        return grid.batch.vorticity()[:, None] / spacing
    places = zip(is_water, grid.find_corner().tolist(), strict=True)
    own = [water[y : y + height, x : x + width] for water, (x, y) in places]
    return grid.batch.vorticity(is_water=torch.stack(own))[:, None]


def lay_together(
    grids: Sequence[Grid], config: FlowConfig, read: Callable[[Grid], Tensor]
) -> Tensor:
    """Return values ``[B, C, Y, X]`` at nodes of the finest level, each of the finest grid there.

    ``read`` returns those ``[B, C, Y, X]`` of a grid; between its nodes they are linear.
    """
    edges, spacing = config.boundaries, grids[0].level.spacing
    wraps = isinstance(edges.left, Periodic), isinstance(edges.bottom, Periodic)
    field = pad(read(grids[0]), (0, int(wraps[0]), 0, int(wraps[1])), mode="circular")
    field = refine_field(field, spacing)[:, :, : config.height, : config.width]
    for grid in grids[1:]:
        own = refine_field(read(grid)[:, :, RING:-RING, RING:-RING], grid.level.spacing)
        corner = grid.find_corner() + RING * grid.level.spacing
        for row, (x, y) in enumerate(corner.tolist()):
            field[row, :, y : y + own.shape[2], x : x + own.shape[3]] = own[row]
    return field


def refine_field(values: Tensor, factor: int) -> Tensor:
    """Return values ``[B, C, Y, X]`` at ``factor`` times as many nodes, linear between theirs."""
    height, width = (factor * (n - 1) + 1 for n in values.shape[-2:])
    if factor == 1:
        return values.clone()
    return interpolate(values, size=(height, width), mode="bilinear", align_corners=True)
