"""The memory of a batch of flows: one block, which processes can share, and its parts."""

from math import prod
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.fast.layout import InPlaceLayout, round_up
from fishrl.physics.flow import FlowParams


class FlowData(NamedTuple):
    """The numbers of a batch of flows: all but populations; float64, every tensor ``[B, ...]``.

    ``clock`` counts the steps since reset.
    """

    clock: Tensor
    params: FlowParams
    bodies: tuple[BodyState, ...]


class GroupMemory(NamedTuple):
    """A group's own part of the memory: flows that advance together.

    Attributes:
        layout: layout of the populations.
        populations: ``[num_slots]`` as stored.
        omega: ``[B, 1]``, or ``[B, cells]`` where it differs from node to node.
        flow: the flows' numbers.
    """

    layout: InPlaceLayout
    populations: Tensor
    omega: Tensor
    flow: FlowData

    def cells(self, parity: int) -> list[Tensor]:
        """Return ``InPlaceLayout.cells`` of the populations."""
        return self.layout.cells(self.populations, parity)

    def incoming(self, parity: int) -> list[Tensor]:
        """Return views ``[B, Y, X]`` of the populations before an even (0) or odd (1) step."""
        return self.layout.nodes(self.populations, parity, False)

    def outgoing(self, parity: int) -> list[Tensor]:
        """Return views ``[B, Y, X]`` of the post-collision populations of a step."""
        return self.layout.nodes(self.populations, parity, True)


class FlowMemory:
    """The layout of one block of memory that processes can share: numbers, omega, populations.

    Args:
        sample: numbers of all flows, for their shapes.
        layout: layout of one group's populations.
        dtype: type of stored populations.
        has_omega_field: whether the relaxation rate differs from node to node.
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
        self._num_omegas = round_up(self._num_envs * self._omega_length)

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
