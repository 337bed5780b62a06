"""The memory of a batch of flows: one block, which processes can share, and its parts."""

from collections.abc import Callable
from math import prod
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.fast.checks import check_tensor
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
    """A group's own part of the memory: flows that advance together."""

    layout: InPlaceLayout  #: layout of the populations
    populations: Tensor  #: ``[num_slots]``
    omega: Tensor  #: ``[B, 1]``, or ``[B, cells]`` where it differs from node to node
    flow: FlowData  #: the flows' numbers

    def cells(self, parity: int) -> list[Tensor]:
        """Return ``InPlaceLayout.cells`` of the populations."""
        return self.layout.cells(self.populations, parity)

    def incoming(self, parity: int) -> list[Tensor]:
        """Return views ``[B, Y, X]`` of the populations before an even (0) or odd (1) step."""
        return self.layout.nodes(self.populations, parity, False)

    def outgoing(self, parity: int) -> list[Tensor]:
        """Return views ``[B, Y, X]`` of the post-collision populations of a step."""
        return self.layout.nodes(self.populations, parity, True)


def carve_memory(
    sample: FlowData,
    layout: InPlaceLayout,
    *,
    has_omega_field: bool,
    allocate: Callable[[int], Tensor],
) -> tuple[FlowData, Tensor, Tensor]:
    """Return numbers, omega ``[B, n]`` and populations ``[groups, num_slots]`` in one block.

    Args:
        sample: numbers of all flows, for their shapes.
        layout: layout of one group's populations.
        has_omega_field: whether the relaxation rate differs from node to node.
        allocate: makes the block, from its size in bytes; processes can share it.
    """
    leaves, form = pytree.tree_flatten(sample)
    num_envs, counts = len(sample.clock), [leaf.numel() for leaf in leaves]
    num_omegas = num_envs * (layout.flow_length if has_omega_field else 1)
    slots = num_envs // layout.num_envs, layout.num_slots
    # populations begin at a cache line: loads that cross it take a tenth of a step
    sizes = [8 * round_up(sum(counts)), 4 * round_up(num_omegas), 4 * prod(slots)]
    doubles, singles, stored = torch.split(allocate(sum(sizes)), sizes)
    parts = torch.split(doubles.view(torch.float64)[: sum(counts)], counts)
    shaped = [part.view(leaf.shape) for part, leaf in zip(parts, leaves, strict=True)]
    flow: FlowData = pytree.tree_unflatten(shaped, form)
    omega = singles.view(torch.float32)[:num_omegas].view(num_envs, -1)
    return flow, omega, stored.view(torch.float32).view(slots)


def set_rows_(own: Any, new: Any, rows: Tensor, *, name: str) -> None:
    """Copy ``rows`` ``[B]`` bool of all tensors ``[B, ...]`` of the nested tuple ``new``.

    Raises:
        ValueError: if forms or shapes differ; then nothing has changed.
    """
    pairs = list(zip(pytree.tree_leaves(own), pytree.tree_leaves(new), strict=True))
    for before, after in pairs:
        check_tensor(name, after, tuple(before.shape))
    for before, after in pairs:
        chosen = rows.view(-1, *(1,) * (before.dim() - 1))
        before.copy_(torch.where(chosen, after, before))
