"""A group of flows that advance together."""

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor

from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.fast.part import Part
from fishrl.physics.storage import Storage


class FlowGroup:
    """A group's populations, and the arguments of the parts of its step.

    Attributes:
        nodes: the nine stored populations ``[B, Y, X]`` before an even step.
        arguments: arguments of each part, at even and odd steps.
        graphs: CUDA graphs by number of pairs of steps.
    """

    def __init__(self, memory: GroupMemory, storage: Storage, parts: Iterable[Part[Any]]) -> None:
        self._storage, self._cells = storage, memory.cells(0)
        self.nodes = memory.incoming(0)
        self.arguments = {part: part.bind(memory) for part in parts}
        self.graphs: dict[int, torch.cuda.CUDAGraph] = {}

    def read(self) -> list[Tensor]:
        """Return the nine incoming populations ``[B, Y, X]``, before an even step."""
        return [self._storage.decode(f) for f in self.nodes]

    def write_(self, rows: Tensor, f: Tensor) -> None:
        """Set the incoming populations ``[N, Q, Y, X]`` of the flows ``rows`` ``[N]``, indices."""
        for view, values in zip(self.nodes, f.unbind(1), strict=True):
            view[rows] = self._storage.encode(values)

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set all cells of the flows in ``rows`` ``[B]`` bool to the populations ``[B]``."""
        for view, value in zip(self._cells, f, strict=True):
            view.copy_(torch.where(rows[:, None], self._storage.encode(value[:, None]), view))
