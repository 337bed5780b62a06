"""One block of memory for all that a batch of flows changes, so that processes can share it."""

from math import prod

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.fast.step import FlowData
from fishrl.physics.streaming import InPlaceLayout


class FlowMemory:
    """The plan of the block: the flows' numbers, relaxation rates and populations, in this order.

    Args:
        sample: numbers of all flows, for their shapes.
        layout: of one group's populations.
        dtype: of the populations.
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
        self._num_omegas = -(-self._num_envs * self._omega_length // 16) * 16

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
