"""Where the outgoing populations of flows lie in memory, for skins that change some of them."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.lattice import CX, CY, Q
from fishrl.physics.skins.links import AGAINST, ALONG, Families, make_families


class Offsets(NamedTuple):
    """Where the populations of a node (x, y) lie from x + y * row_length on, int64."""

    leaving: Tensor  #: ``[Q, 1]`` by direction
    arriving: Tensor  #: ``[Q, 1]`` those that come from the nodes around it
    along: Tensor  #: ``[4, 1]`` leaving with the lines of each family
    against: Tensor  #: ``[4, 1]`` leaving against them


class Slots(NamedTuple):
    """Outgoing populations of nodes, in a flat buffer ``data``."""

    nodes: Tensor  #: ``[B, Y, X]`` the first populations, for the sizes of the grid
    data: Tensor  #: populations after collision; changed in place
    offsets: Offsets
    first: Tensor  #: ``[B]`` int64, of each flow's node (0, 0)
    scrap: Tensor  #: ``[B]`` int64, a slot of each flow that nobody reads
    families: Families  #: of lattice lines

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the grid in nodes."""
        return self.nodes.shape[2], self.nodes.shape[1]

    def find(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the places of nodes, int32."""
        return y.int() * self.nodes.stride(1) + x.int()

    def read(self, node: Tensor, offset: Tensor) -> Tensor:
        """Return populations at an offset from the places of nodes ``[B, ...]``."""
        return self.data[_widen(self.first, node) + (offset + node)]

    def read_all(self, node: Tensor, offsets: Tensor) -> list[Tensor]:
        """Return nine populations ``[B, ...]`` of nodes at ``[Q, 1]`` offsets."""
        return [self.read(node, offset) for offset in offsets.unbind()]

    def write_(self, node: Tensor, offset: Tensor, values: Tensor, where: Tensor) -> None:
        """Set them ``where`` true."""
        slot = _widen(self.first, node) + (offset + node)
        slot = torch.where(where, slot, _widen(self.scrap, node))
        self.data.index_put_((slot,), torch.where(where, values, 0.0))

    def get_nodes(self, like: Tensor) -> list[Tensor]:
        """Return nine populations shaped like ``like`` ``[B, Y, X]``, of ``copy_slots``."""
        return [*self.data[len(like) :].view(len(like), Q, *like.shape[1:]).unbind(1)]


def _widen(values: Tensor, like: Tensor) -> Tensor:
    """Return values ``[B]`` as ``[B, 1, ...]``."""
    return values.view(-1, *[1] * (like.dim() - 1))


def make_offsets(leaving: Sequence[int], arriving: Sequence[int], device: torch.device) -> Offsets:
    """Return the offsets of populations, by direction."""
    pairs = ([leaving[q] for q in directions] for directions in (ALONG, AGAINST))
    tables = leaving, arriving, *pairs
    return Offsets(*(torch.tensor(table, device=device)[:, None] for table in tables))


def copy_slots(outgoing: Sequence[Tensor]) -> Slots:
    """Copy nine populations ``[B, Y, X]`` into a buffer, whose first B slots are scrap."""
    num, height, width = outgoing[0].shape
    data = torch.cat((outgoing[0].new_zeros(num), torch.stack(list(outgoing), 1).flatten()))
    leaving = [q * height * width for q in range(Q)]
    arriving = [own - CY[q] * width - CX[q] for q, own in enumerate(leaving)]
    flow = torch.arange(num, device=data.device)
    return Slots(
        nodes=data[num:].view(num, Q, height, width)[:, 0],
        data=data,
        offsets=make_offsets(leaving, arriving, data.device),
        first=num + flow * (Q * height * width),
        scrap=flow,
        families=make_families(data.device),
    )
