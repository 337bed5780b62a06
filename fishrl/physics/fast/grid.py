"""One grid of a batch of flows with levels, and its place among the others."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.fast.part import Part
from fishrl.physics.fast.transfer_parts import Moving, PatchMemory
from fishrl.physics.levels.grids import Level
from fishrl.physics.levels.transfer import clamp_origin


@dataclass(eq=False)
class Grid:
    """One grid of all flows, and what passes between it and its parent."""

    level: Level
    batch: FlowBatch
    origin: Tensor  #: ``[B, 2]`` int64, of a patch in its parent; the root's is 0
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


def find_origins(grids: Sequence[Grid], corners: Tensor) -> list[Tensor]:
    """Return the origin ``[N, 2]`` of each of a flow's grids from all corners ``[N, G, 2]``.

    Raises:
        ValueError: for a corner that is not on a node of its parent, or too near its edges.
    """
    places = dict(zip(map(id, grids), corners.unbind(1), strict=True))
    origins = []
    for number, grid in enumerate(grids):
        start, unit = 0 * corners[:, 0], 1
        if grid.parent is not None:
            start, unit = places[id(grid.parent)], grid.parent.level.spacing
        away, (_, low, high) = places[id(grid)] - start, grid.level.frame
        origin = away // unit
        is_right = (origin * unit == away) & (clamp_origin(origin, low, high) == origin)
        if not is_right.all():
            wrong, (first, last) = (
                (~is_right).any(-1),
                [tuple(unit * n for n in e) for e in (low, high)],
            )
            raise ValueError(
                f"the corner of grid {number} is {tuple(away[wrong][0].tolist())} nodes from its "
                f"parent's: allowed are multiples of {unit} from {first} to {last}"
            )
        origins.append(origin)
    return origins


def read_fields(grid: Grid) -> Tensor:
    """Return density and velocity of a grid ``[B, 3, Y, X]``."""
    rho, u = grid.batch.macroscopic()
    return torch.cat((rho[:, None], u), 1)


def refine_field(values: Tensor, factor: int) -> Tensor:
    """Return values ``[B, C, Y, X]`` at ``factor`` times as many nodes, linear between theirs."""
    height, width = (factor * (n - 1) + 1 for n in values.shape[-2:])
    if factor == 1:
        return values.clone()
    return interpolate(values, size=(height, width), mode="bilinear", align_corners=True)
