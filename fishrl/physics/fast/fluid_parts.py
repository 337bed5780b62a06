"""The fluid's parts of the fast step: collision, periodic and other edges, check."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.boundaries import Boundary, Side
from fishrl.physics.collision import collide_mrt, compute_moments
from fishrl.physics.fast.flow_memory import GroupMemory
from fishrl.physics.fast.part import Part
from fishrl.physics.flow import FlowConfig, FlowParams, compute_stream_speed
from fishrl.physics.lattice import OPPOSITE

# A flow whose speed passes this (Mach 0.87), or whose density differs from that at rest by all of
# it, is beyond the method and counts as diverged.
MAX_SPEED = 0.5


def make_collision(config: FlowConfig) -> Part:
    """Return the part that collides all nodes without force; on the incoming views it streams too.

    Its tensors are the clock ``[B]``, omega ``[B, 1]`` or ``[B, cells]``, and all cells, rings
    included: one loop over contiguous memory.
    """
    rates = config.rates

    def collect(memory: GroupMemory, parity: int) -> tuple[Tensor, Tensor, list[Tensor]]:
        return memory.flow.clock, memory.omega, memory.cells(parity)

    def act(clock: Tensor, omega: Tensor, f: list[Tensor]) -> None:
        """Count the step and write each population to the opposite one's slot."""
        clock.add_(1.0)
        collided = collide_mrt(f, omega, rates)
        for q, g in enumerate(collided):
            f[OPPOSITE[q]].copy_(g)

    # on a GPU, blocks and warps are chosen by time: 174 instead of 208 us on an H200
    return Part("collision", collect, act, {"cuda": {"max_autotune_pointwise": True}})


def make_crossing(config: FlowConfig) -> Part:
    """Return the part that carries what leaves over a periodic edge to the other side.

    It stays eager: its copies need no code of their own.
    """
    crossings = config.boundaries.list_crossings(config.height, config.width)

    def collect(memory: GroupMemory, parity: int) -> tuple[list[Tensor], list[Tensor]]:
        incoming, outgoing = memory.incoming(1 - parity), memory.outgoing(parity)
        entering = [incoming[q][to] for q, to, _ in crossings]
        return entering, [outgoing[q][at] for q, _, at in crossings]

    def act(entering: list[Tensor], leaving: list[Tensor]) -> None:
        for to, origin in zip(entering, leaving, strict=True):
            to.copy_(origin)

    return Part("crossing", collect, act, None)


class EdgeViews(NamedTuple):
    """Views ``[B, n]`` of one edge or ``[B, 2, n]`` of two, nine each, and the profile ``[n + 2]``.

    ``edge`` and ``neighbour`` are incoming populations of the edge's nodes and of those next to
    them, ``outgoing`` the edge's own after collision.
    """

    edge: list[Tensor]
    neighbour: list[Tensor]
    outgoing: list[Tensor]
    profile: Tensor


def _view(f: Sequence[Tensor], edges: Sequence[tuple[slice | int, ...]]) -> list[Tensor]:
    """Return views of populations at the nodes of one edge ``[B, n]`` or of two ``[B, 2, n]``."""
    if len(edges) == 1:
        return [own[edges[0]] for own in f]
    views = []
    for low, high in ([own[edge] for edge in edges] for own in f):
        between = high.storage_offset() - low.storage_offset()
        shape, strides = (len(low), 2, low.shape[1]), (low.stride(0), between, low.stride(1))
        views.append(low.as_strided(shape, strides))
    return views


def make_edges(
    config: FlowConfig, sides: Sequence[tuple[Side, Boundary]], device: torch.device
) -> Part:
    """Return the part that sets the edges ``sides``, which do not depend on each other."""
    (first, boundary), *others = sides
    # two rows that are alike are one tensor: half the code to compile
    is_pair = boundary.ignores_side and [own for _, own in others] == [boundary] and first.value[1]
    chosen = [([side for side, _ in sides], boundary)] if is_pair else [([s], b) for s, b in sides]
    profiles = []
    for (side, *_), _ in chosen:
        num_nodes = config.height if side.value[0] else config.width
        profile = config.boundaries.evaluate_profile(side, num_nodes)
        profiles.append(profile.to(device, torch.float32))

    def collect(memory: GroupMemory, parity: int) -> tuple[list[EdgeViews], Tensor, FlowParams]:
        incoming, outgoing = memory.incoming(1 - parity), memory.outgoing(parity)
        edges = [
            EdgeViews(
                edge=_view(incoming, [side.edge for side in own]),
                neighbour=_view(incoming, [side.neighbour for side in own]),
                outgoing=_view(outgoing, [side.edge for side in own]),
                profile=profile,
            )
            for (own, _), profile in zip(chosen, profiles, strict=True)
        ]
        return edges, memory.flow.clock, memory.flow.params._replace(bodies=())

    def act(edges: list[EdgeViews], clock: Tensor, params: FlowParams) -> None:
        """Set the populations that enter at each edge, at the present speed of the stream."""
        speed = compute_stream_speed(params, clock).float()
        for ((side, *_), boundary), views in zip(chosen, edges, strict=True):
            stream = speed.view(-1, *[1] * (views.edge[0].dim() - 1)) * views.profile
            entering = boundary.compute_edge(side, views.neighbour, views.outgoing, stream)
            for q, values in entering.items():
                views.edge[q].copy_(values)

    # on a GPU the stream's speed is not worth a kernel of its own
    settings = {
        "cuda": {
            "combo_kernels": True,
            "realize_reads_threshold": 16,
            "realize_opcount_threshold": 1000,
        }
    }
    name = f"edges {[side.name for side, _ in sides]}"
    return Part(name, collect, act, settings, any_grid=True)


def make_check(is_fine: Tensor) -> Part:
    """Return the part that writes to ``is_fine`` ``[B]`` bool which flows have not diverged.

    Those whose density or speed is out of range or not finite at a node have.
    """

    def collect(memory: GroupMemory, parity: int) -> tuple[list[Tensor], Tensor]:
        return memory.incoming(parity), is_fine

    def act(f: list[Tensor], is_fine: Tensor) -> None:
        drho, jx, jy = compute_moments(f)
        limit = MAX_SPEED * (drho + 1.0)
        # comparisons with NaN are false, so a broken flow is never fine
        is_node_fine = (jx * jx + jy * jy < limit * limit) & (drho.abs() < 1.0)
        is_fine.copy_(is_node_fine.all((1, 2)))

    return Part("check", collect, act, {}, any_grid=True)
