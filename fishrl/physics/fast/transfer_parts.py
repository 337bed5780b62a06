"""What passes between grids in the fast step: filling, restriction, and patches that move."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.fast.part import Part, Repeater
from fishrl.physics.fast.recording import Call
from fishrl.physics.lattice import Q
from fishrl.physics.levels.grids import Frame, Level, find_middle, find_shift
from fishrl.physics.levels.transfer import (
    coarsen,
    crop_ring,
    list_restricted,
    list_strips,
    refine,
)

#: Layers of the parent's nodes that are restricted in each step; all others once in many.
_NUM_RESTRICTED = 2


class PatchMemory(NamedTuple):
    """A group's memory of a patch and of its parent, and the patch's place."""

    patch: GroupMemory
    parent: GroupMemory
    origin: Tensor  #: ``[B, 2]`` int64, as ``PatchState.origin``

    @property
    def populations(self) -> Tensor:
        """Populations of the patch."""
        return self.patch.populations


class Cells(NamedTuple):
    """Where populations of some nodes lie in a buffer."""

    data: Tensor  #: populations
    offsets: Tensor  #: ``[Q]`` int64, of the slots of each incoming population
    first: Tensor  #: ``[B]`` int64, cells of node (0, 0)
    row: Tensor  #: int64, cells from a row to the next
    x: Tensor  #: nodes, int64 of any shape
    y: Tensor

    def find(self, origin: Tensor | None = None) -> Tensor:
        """Return cells ``[B, ...]``; nodes count from ``origin`` ``[B, 2]``."""
        cells = self.y * self.row + self.x
        first = self.first
        if origin is not None:
            first = first + origin[:, 1] * self.row + origin[:, 0]
        return first.view(-1, *[1] * cells.dim()) + cells


def find_cells(memory: GroupMemory, parity: int, x: Tensor, y: Tensor) -> Cells:
    """Return where the incoming populations of nodes lie before a step of a parity."""
    layout, device = memory.layout, memory.populations.device
    flows = torch.arange(layout.num_envs, device=device)
    return Cells(
        data=memory.populations,
        offsets=torch.tensor(layout.offsets(parity, False), device=device),
        first=flows * layout.flow_length + layout.first_cell,
        row=torch.tensor(layout.row_length, device=device),
        x=x.to(device),
        y=y.to(device),
    )


def make_filling(width: int, height: int) -> Part:
    """Return the part that fills the ring of a patch, at the parity of its parent's next step."""
    strips = list_strips(width, height)
    crops = [strip.crop for strip in strips]

    def collect(
        memory: PatchMemory, parity: int
    ) -> tuple[list[tuple[Cells, Cells]], Tensor, Tensor]:
        cells = [
            (
                find_cells(memory.parent, parity, strip.parent_x, strip.parent_y),
                find_cells(memory.patch, 0, strip.x, strip.y),
            )
            for strip in strips
        ]
        return cells, memory.origin, memory.patch.flow.params.tau

    def act(cells: list[tuple[Cells, Cells]], origin: Tensor, tau: Tensor) -> None:
        for (coarse, fine), crop in zip(cells, crops, strict=True):
            source, target = coarse.find(origin), fine.find()
            f = refine([coarse.data[source + coarse.offsets[q]] for q in range(Q)], tau)
            for q, values in enumerate(f):
                fine.data.index_put_((target + fine.offsets[q],), crop_ring(values, crop))

    return Part("filling", collect, act, {"cpu": {"cpp.threads": 1}}, any_grid=True)


def make_restriction(width: int, height: int, *, is_whole: bool) -> Part:
    """Return the part that restricts a patch, at the parity of its parent's next step.

    It takes all nodes, or only the layers that the parent depends on.
    """
    x, y = list_restricted(width, height, None if is_whole else _NUM_RESTRICTED)

    def collect(memory: PatchMemory, parity: int) -> tuple[tuple[Cells, Cells], Tensor, Tensor]:
        fine = find_cells(memory.patch, 0, x, y)
        coarse = find_cells(memory.parent, parity, x // 2, y // 2)
        return (fine, coarse), memory.origin, memory.patch.flow.params.tau

    def act(cells: tuple[Cells, Cells], origin: Tensor, tau: Tensor) -> None:
        fine, coarse = cells
        source, target = fine.find(), coarse.find(origin)
        f = coarsen([fine.data[source + fine.offsets[q]] for q in range(Q)], tau)
        for q, values in enumerate(f):
            coarse.data.index_put_((target + coarse.offsets[q],), values)

    return Part("restriction", collect, act, {"cpu": {"cpp.threads": 1}}, any_grid=True)


class Moving(NamedTuple):
    """A group's patch that follows a body."""

    nodes: list[Tensor]  #: nine incoming populations ``[B, Y, X]``
    origin: Tensor  #: ``[B, 2]`` int64
    by: Tensor  #: ``[B, 2]`` int64, nodes of the parent by which to move
    bodies: tuple[BodyState, ...]  #: in it, if it is the finest

    @property
    def populations(self) -> Tensor:
        """Some of its populations."""
        return self.nodes[0]


class Chain(NamedTuple):
    """A group's patches around one body, coarsest first."""

    patches: list[Moving]

    @property
    def populations(self) -> Tensor:
        """Some of their populations."""
        return self.patches[0].nodes[0]


def make_shift_choice(levels: Sequence[Level]) -> Part:
    """Return the part that finds out by how much the patches around a body must move.

    ``levels`` are theirs, coarsest first.
    """
    frames, ahead = [level.frame for level in levels], levels[-1].ahead

    def collect(memory: Chain, parity: int) -> tuple[Tensor, Tensor, list[Tensor], list[Tensor]]:
        body = memory.patches[-1].bodies[0]
        origins, by = [m.origin for m in memory.patches], [m.by for m in memory.patches]
        return body.position, body.heading, origins, by

    def act(position: Tensor, heading: Tensor, origins: list[Tensor], shifts: list[Tensor]) -> None:
        place = find_middle(position, heading, ahead)
        inside: list[tuple[Tensor, Frame]] = []
        for frame, origin, by in reversed(list(zip(frames, origins, shifts, strict=True))):
            chosen = find_shift(place, origin, frame, inside)
            by.copy_(chosen)
            place, inside = origin + 0.5 * place, [(origin + chosen, frame)]

    return Part("shift choice", collect, act, {"cpu": {"cpp.threads": 1}})


class Shifting:
    """Moves the patches of a group by what ``make_shift_choice`` has chosen.

    Args:
        chains: patches around each body that is followed.
        by: all their ``by``, in one block.
        before: fills the rings.
        after: finds out again where still bodies and sharp skins are.
    """

    def __init__(
        self, chains: Sequence[Chain], by: Tensor, before: Repeater, after: Repeater
    ) -> None:
        self._chains, self._before, self._after, self._by = chains, before, after, by.numpy()

    def run(self) -> None:
        """Move what is due, which is rare."""
        if not self._by.any():
            return
        self._before.run(1)
        for chain in self._chains:
            for patch, inside in zip(chain.patches, (*chain.patches[1:], None), strict=True):
                for row, (x, y) in enumerate(patch.by.tolist()):
                    for f in patch.nodes if x or y else ():
                        f[row].copy_(f[row].roll((-2 * y, -2 * x), (0, 1)))
                patch.origin.add_(patch.by)
                for body in patch.bodies:
                    body.position.sub_(2 * patch.by)
                if inside is not None:
                    inside.origin.sub_(2 * patch.by)
        self._after.run(1)

    def record(self, tensors: Sequence[Tensor]) -> list[Call]:
        """Run once, and return the call that does it again."""
        self.run()
        return [self.run]
