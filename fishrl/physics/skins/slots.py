"""Where the outgoing populations of flows lie in memory, for skins that change some of them."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.lattice import CX, CY, Q, W


class Slots(NamedTuple):
    """Where the outgoing populations of nodes lie in a flat buffer ``data``."""

    data: Tensor  #: populations after collision; changed in place
    offsets: Tensor  #: ``[Q]`` int64, by direction
    first: Tensor  #: ``[B]`` int64, of each flow's node (0, 0)
    row_length: int  #: from a node to the next along y
    scrap: Tensor  #: ``[B]`` int64, a slot of each flow that nobody reads
    lattice: Tensor  #: ``[Q, 3]`` float64, c_x, c_y and w of each direction

    def read(self, x: Tensor, y: Tensor, q: Tensor) -> Tensor:
        """Return outgoing populations q of nodes (x, y), int64 ``[B, ...]``."""
        return self.data[self._find(x, y, q)]

    def write_(self, x: Tensor, y: Tensor, q: Tensor, values: Tensor, where: Tensor) -> None:
        """Set them ``where`` true."""
        index = torch.where(where, self._find(x, y, q), _widen(self.scrap, x))
        self.data.index_put_((index,), torch.where(where, values, 0.0))

    def get_nodes(self, like: Tensor) -> list[Tensor]:
        """Return nine populations shaped like ``like`` ``[B, Y, X]``, of ``copy_slots``."""
        return [*self.data[len(like) :].view(len(like), Q, *like.shape[1:]).unbind(1)]

    def _find(self, x: Tensor, y: Tensor, q: Tensor) -> Tensor:
        return _widen(self.first, x) + self.offsets[q] + y * self.row_length + x


def _widen(values: Tensor, like: Tensor) -> Tensor:
    """Return values ``[B]`` as ``[B, 1, ...]``."""
    return values.view(-1, *[1] * (like.dim() - 1))


def make_lattice(device: torch.device) -> Tensor:
    """Return ``Slots.lattice``."""
    return torch.tensor([CX, CY, W], dtype=torch.float64, device=device).T.contiguous()


def copy_slots(outgoing: Sequence[Tensor]) -> Slots:
    """Copy nine populations ``[B, Y, X]`` into a buffer, whose first B slots are scrap."""
    num, height, width = outgoing[0].shape
    data = torch.cat((outgoing[0].new_zeros(num), torch.stack(list(outgoing), 1).flatten()))
    flow = torch.arange(num, device=data.device)
    return Slots(
        data=data,
        offsets=torch.arange(Q, device=data.device) * (height * width),
        first=num + flow * (Q * height * width),
        row_length=width,
        scrap=flow,
        lattice=make_lattice(data.device),
    )
