"""Where a batch of flows lies in memory.

Populations stream in place (AA pattern, Bailey et al. 2009): one buffer, two kinds of step. An even
step reads and writes the node's own slots, swapping opposite directions; an odd step reads from and
writes to the neighbours' slots. The addresses imply streaming; each step moves 72 bytes a node in
single precision and needs no second buffer.

Slot q of cell n is ``data[q, pad + n]``. The cells of a group's flows lie in one row, each flow
padded by a ring of one node whose values the flow itself never reads. With V[q] the slots q at the
cells n + c_q and S[q] those at n, the incoming population q is S[q] before an even step and
V[opposite q] before an odd one.
"""

from math import prod
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.flow import FlowParams
from fishrl.physics.lattice import CX, CY, OPPOSITE, Q


class FlowData(NamedTuple):
    """Everything about a batch of flows except populations, float64, every tensor ``[B, ...]``.

    ``clock`` counts the steps since reset.
    """

    clock: Tensor
    params: FlowParams
    bodies: tuple[BodyState, ...]


def _round_up(n: int) -> int:
    return -(-n // 16) * 16


class InPlaceLayout:
    """Where the populations of ``num_envs`` flows lie, and the views of even and odd steps."""

    def __init__(self, *, num_envs: int, height: int, width: int) -> None:
        self.num_envs, self.height, self.width = num_envs, height, width
        self.row_length = _round_up(width + 2)
        self.flow_length = _round_up((height + 2) * self.row_length)
        self.num_cells = num_envs * self.flow_length
        self.pad = _round_up(self.row_length + 1)
        self.slot_length = self.num_cells + 2 * self.pad
        self.first_cell = self.row_length + 1  # of node (0, 0) within its flow
        self.num_slots = Q * self.slot_length

    def offsets(self, parity: int, outgoing: bool) -> list[int]:
        """Return, by direction, the flat index of cell 0's slot at even (0) or odd (1) ``parity``.

        The slots are those of post-collision populations after the step if ``outgoing``, else of
        incoming ones before it.
        """
        shift = [CY[q] * self.row_length + CX[q] for q in range(Q)]
        own = [q * self.slot_length + self.pad for q in range(Q)]
        swapped = bool(parity) != outgoing
        at_neighbour = bool(parity)
        slots = [OPPOSITE[q] if swapped else q for q in range(Q)]
        return [own[s] + (shift[s] if at_neighbour else 0) for s in slots]

    def cells(self, data: Tensor, parity: int) -> list[Tensor]:
        """Return nine ``[B, cells]`` views of the incoming populations, rings included."""
        size, stride = (self.num_envs, self.flow_length), (self.flow_length, 1)
        first = data.storage_offset()
        return [data.as_strided(size, stride, first + o) for o in self.offsets(parity, False)]

    def nodes(self, data: Tensor, parity: int, outgoing: bool) -> list[Tensor]:
        """Return nine ``[B, Y, X]`` views without the rings."""
        size = (self.num_envs, self.height, self.width)
        stride = (self.flow_length, self.row_length, 1)
        first = data.storage_offset() + self.first_cell
        return [data.as_strided(size, stride, first + o) for o in self.offsets(parity, outgoing)]

    def strip_rings(self, cells: Tensor) -> Tensor:
        """Return a view ``[B, Y, X]`` of values ``[B, cells]`` without the rings."""
        rows = cells[:, : (self.height + 2) * self.row_length].view(len(cells), -1, self.row_length)
        return rows[:, 1 : self.height + 1, 1 : self.width + 1]


class FlowMemory:
    """The layout of one block of memory that processes can share: numbers, omega, populations.

    ``sample`` holds the numbers of all flows, ``layout`` that of one group's populations of
    ``dtype``; with ``has_omega_field`` the relaxation rate differs from node to node.
    """

    def __init__(
        self,
        sample: FlowData,
        layout: InPlaceLayout,
        *,
        dtype: torch.dtype,
        has_omega_field: bool,
    ) -> None:
        leaves, self._form = pytree.tree_flatten(sample)
        self._shapes = [leaf.shape for leaf in leaves]
        self._num_envs, self._dtype = len(sample.clock), dtype
        self._omega_length = layout.flow_length if has_omega_field else 1
        self._slots = self._num_envs // layout.num_envs, layout.num_slots
        self._num_doubles: int = sum(prod(shape) for shape in self._shapes)
        self._num_omegas = _round_up(self._num_envs * self._omega_length)

    def count_bytes(self) -> int:
        """Return the size of the block."""
        return self._first_slot + self._dtype.itemsize * self._slots[0] * self._slots[1]

    @property
    def _first_slot(self) -> int:
        return 8 * self._num_doubles + 4 * self._num_omegas

    def carve(self, memory: Tensor) -> tuple[FlowData, Tensor, Tensor]:
        """Return views of the block ``[bytes]``: numbers, omega ``[B, n]``, populations."""
        doubles = memory[: 8 * self._num_doubles].view(torch.float64)
        sizes = [prod(shape) for shape in self._shapes]
        parts = [
            part.view(shape)
            for part, shape in zip(torch.split(doubles, sizes), self._shapes, strict=True)
        ]
        singles = memory[8 * self._num_doubles : self._first_slot].view(torch.float32)
        omega = singles[: self._num_envs * self._omega_length].view(self._num_envs, -1)
        populations = memory[self._first_slot :].view(self._dtype).view(self._slots)
        flow: FlowData = pytree.tree_unflatten(parts, self._form)
        return flow, omega, populations
