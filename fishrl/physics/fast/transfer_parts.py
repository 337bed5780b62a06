"""What passes between grids in the fast step: filling, restriction, and patches that move."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.fast.inductor import GATHERING
from fishrl.physics.fast.part import Part, Repeater, copy_tree
from fishrl.physics.fast.recording import Call
from fishrl.physics.levels.grids import Level, choose_shifts, find_middle
from fishrl.physics.levels.patch import RING
from fishrl.physics.levels.transfer import (
    FIRST_RESTRICTED,
    add,
    coarsen,
    count,
    fill_ring,
    list_restricted,
    list_sources,
    move,
    number_cells,
    number_ring,
)

SETTINGS: dict[str, dict[str, object]] = {
    # no check of indices, which tables hold
    "cpu": GATHERING | {"cpp.threads": 1, "assert_indirect_indexing": False},
    "cuda": {"combo_kernels": True},
}


class PatchMemory(NamedTuple):
    """A group's memory of a patch and of its parent, and the patch's place."""

    patch: GroupMemory
    parent: GroupMemory
    origin: Tensor  #: ``[B, 2]`` int64, as ``PatchState.origin``


class Cells(NamedTuple):
    """Where populations of some nodes lie in a buffer."""

    data: Tensor  #: populations
    offsets: Tensor  #: ``[Q]`` int64, of the slots of each incoming population
    first: Tensor  #: ``[B]`` int64, cells of node (0, 0)
    row: Tensor  #: int64, cells from a row to the next
    cells: Tensor  #: ``[...]`` int64, counted from those

    @staticmethod
    def find(memory: GroupMemory, parity: int, cells: Tensor) -> "Cells":
        """Return where nodes lie before a step of a parity."""
        layout, device = memory.layout, memory.populations.device
        flows = torch.arange(layout.num_envs, device=device)
        return Cells(
            data=memory.populations,
            offsets=torch.tensor(layout.offsets(parity, False), device=device),
            first=flows * layout.flow_length + layout.first_cell,
            row=torch.tensor(layout.row_length, device=device),
            cells=cells.contiguous().to(device),
        )

    def read(self, origin: Tensor | None = None) -> Sequence[Tensor]:
        """Return nine incoming populations ``[B, ...]``; the nodes may count from an origin."""
        cells = self._find(origin)
        # as index -1 is none of these, it need not count from the end
        return self.data.expand(*cells.shape[:-1], -1).gather(-1, cells).unbind()

    def write_(self, values: Tensor, origin: Tensor | None = None) -> None:
        """Set them to ``[Q, B, ...]``."""
        self.data.index_put_((self._find(origin),), values)

    def _find(self, origin: Tensor | None) -> Tensor:
        first = self.first if origin is None else self.first + count(origin, self.row)
        return add(self.offsets, add(first, self.cells))


def make_filling(width: int, height: int) -> Part:
    """Return the part that fills the ring of a patch, at the parity of its parent's next step."""

    def collect(memory: PatchMemory, parity: int) -> tuple[tuple[Cells, Cells], Tensor, Tensor]:
        ring = number_ring(width, height, row := memory.patch.layout.row_length)
        ring = ring.where(ring >= 0, -row - 1)  # node (-1, -1), which nobody reads
        sources = list_sources(width, height, memory.parent.layout.row_length)
        cells = Cells.find(memory.patch, 0, ring), Cells.find(memory.parent, parity, sources)
        return cells, memory.origin, memory.patch.flow.params.tau

    def act(cells: tuple[Cells, Cells], origin: Tensor, tau: Tensor) -> None:
        ring, sources = cells
        ring.write_(fill_ring(sources.read(origin), tau))

    return Part("filling", collect, act, SETTINGS, any_grid=True)


def make_restriction(*, is_whole: bool) -> Part:
    """Return the part that restricts a patch, at the parity of its parent's next step.

    It takes all nodes, or only the two layers that the parent depends on: they keep all that lies
    outside the patch, or will when it shifts, independent of what the parent has further inside.
    """

    def choose(cells: Tensor) -> Tensor:
        chosen = torch.ones_like(cells, dtype=torch.bool)
        chosen[RING:-RING, RING:-RING] = is_whole
        return cells[chosen]

    def collect(memory: PatchMemory, parity: int) -> tuple[tuple[Cells, Cells], Tensor, Tensor]:
        layout, row = memory.patch.layout, memory.parent.layout.row_length
        every = number_cells(layout.height, layout.width, layout.row_length)
        (inner,) = list_restricted([every[None]])
        height, width = inner.shape[1:]
        coarse = number_cells(height, width, row, FIRST_RESTRICTED // 2)
        cells = (
            Cells.find(memory.patch, 0, choose(inner[0])),
            Cells.find(memory.parent, parity, choose(coarse)),
        )
        return cells, memory.origin, memory.patch.flow.params.tau

    def act(cells: tuple[Cells, Cells], origin: Tensor, tau: Tensor) -> None:
        fine, coarse = cells
        coarse.write_(torch.stack(coarsen(fine.read(), tau)), origin)

    return Part("restriction", collect, act, SETTINGS, any_grid=True)


#: The grids around one body, coarsest first, and ``[n, B, 2]`` int64, nodes to move them by.
Chain = tuple[list[PatchMemory], Tensor]


def make_shift_choice(levels: Sequence[Level]) -> Part:
    """Return the part that finds out by how much the patches around a body must move.

    ``levels`` are theirs, coarsest first.
    """
    frames, ahead = [level.frame for level in levels], levels[-1].ahead

    def collect(memory: Chain, parity: int) -> tuple[BodyState, list[Tensor], list[Tensor]]:
        grids, by = memory
        return grids[-1].patch.flow.bodies[0], [grid.origin for grid in grids], [*by]

    def act(body: BodyState, origins: list[Tensor], shifts: list[Tensor]) -> None:
        copy_tree(shifts, choose_shifts(find_middle(body, ahead), origins, frames))

    return Part("shift choice", collect, act, SETTINGS)


def make_moving(device: torch.device) -> Part:
    """Return the part that moves patches by what ``make_shift_choice`` has chosen."""

    def collect(
        memory: Chain, parity: int
    ) -> tuple[list[list[Tensor]], list[Tensor], list[Tensor], list[Tensor]]:
        grids, by = memory
        nodes, origins = zip(*((own.patch.incoming(0), own.origin) for own in grids), strict=True)
        positions = [body.position for own in grids for body in own.patch.flow.bodies]
        return [*nodes], [*origins], [*by], positions

    def act(
        nodes: list[list[Tensor]], origins: list[Tensor], by: list[Tensor], positions: list[Tensor]
    ) -> None:
        outer = None
        for f, origin, own in zip(nodes, origins, by, strict=True):
            copy_tree(f, move(f, own))
            origin.add_(own if outer is None else own - 2 * outer)
            outer = own
        for position in positions:
            position.sub_(2 * by[-1])

    # so rare on a CPU that it is not worth compiling
    return Part("moving", collect, act, SETTINGS if device.type == "cuda" else None)


class Occasionally:
    """Steps that a CPU leaves out where no patch moves by any of ``by``; a GPU takes them all."""

    def __init__(self, by: Tensor, steps: Repeater) -> None:
        self._by, self._steps = by.numpy(), steps

    def run(self) -> None:
        """Take the steps if a patch moves."""
        if self._by.any():
            self._steps.run(1)

    def record(self, tensors: Sequence[Tensor]) -> list[Call]:
        """Run once, and return the call that does it again."""
        self.run()
        return [self.run]
