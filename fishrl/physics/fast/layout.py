"""Where the populations of a group of flows lie in memory.

Populations stream in place (AA pattern, Bailey et al. 2009): one buffer, two kinds of step. An even
step reads and writes the node's own slots, swapping opposite directions; an odd step reads from and
writes to the neighbours' slots. The addresses imply streaming; each step moves 72 bytes a node in
single precision and needs no second buffer.

Slot q of cell n is ``data[q, pad + n]``. The cells of a group's flows lie in one row, each flow
padded by a ring of one node whose values the flow itself never reads. With V[q] the slots q at the
cells n + c_q and S[q] those at n, the incoming population q is S[q] before an even step and
V[opposite q] before an odd one.
"""

from torch import Tensor

from fishrl.physics.lattice import CX, CY, OPPOSITE, Q


def round_up(n: int) -> int:
    """Return the next multiple of 16, the numbers in a cache line."""
    return -(-n // 16) * 16


class InPlaceLayout:
    """Where the populations of ``num_envs`` flows lie, and the views of even and odd steps."""

    def __init__(self, *, num_envs: int, height: int, width: int) -> None:
        self.num_envs, self.height, self.width = num_envs, height, width
        self.row_length = round_up(width + 2)
        self.flow_length = round_up((height + 2) * self.row_length)
        self.num_cells = num_envs * self.flow_length
        self.pad = round_up(self.row_length + 1)
        self.slot_length = self.num_cells + 2 * self.pad
        self.first_cell = self.row_length + 1  # of node (0, 0) within its flow
        self.num_slots = Q * self.slot_length

    def offsets(self, parity: int, outgoing: bool) -> list[int]:
        """Return, by direction, the flat index of cell 0's slot at even (0) or odd (1) ``parity``.

        With ``outgoing``, the slots hold post-collision populations after the step, otherwise
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
