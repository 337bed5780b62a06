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


class CollideTensors(NamedTuple):
    """``clock`` ``[B]``, ``omega`` ``[B, 1]`` or ``[B, cells]``, incoming ``f`` ``[B, cells]``."""

    clock: Tensor
    omega: Tensor
    f: list[Tensor]


class Collide(Part[CollideTensors]):
    """Collide all nodes without force; on the incoming views this streams as well."""

    title = "collision"

    def __init__(self, config: FlowConfig) -> None:
        super().__init__()
        self._storage, self._rates = config.storage, config.rates

    def collect(self, memory: GroupMemory, parity: int) -> CollideTensors:
        """Return all cells, rings included: one loop over contiguous memory."""
        return CollideTensors(memory.flow.clock, memory.omega, memory.cells(parity))

    def act(self, tensors: CollideTensors) -> None:
        """Count the step and write each population to the opposite one's slot."""
        tensors.clock.add_(1.0)
        decoded = [self._storage.decode(g) for g in tensors.f]
        for q, g in enumerate(collide_mrt(decoded, tensors.omega, self._rates)):
            tensors.f[OPPOSITE[q]].copy_(self._storage.encode(g))


class CrossTensors(NamedTuple):
    """Views of what enters over periodic edges, and of what left on the other side."""

    entering: list[Tensor]
    leaving: list[Tensor]


class CrossPeriodic(Part[CrossTensors]):
    """Carry the populations that leave over a periodic edge to the other side; never compiled."""

    title = "edges"

    def __init__(self, config: FlowConfig) -> None:
        super().__init__()
        self._crossings = config.boundaries.list_crossings(config.height, config.width)

    def collect(self, memory: GroupMemory, parity: int) -> CrossTensors:
        """Return the views of all directions."""
        incoming, outgoing = memory.incoming(1 - parity), memory.outgoing(parity)
        return CrossTensors(
            entering=[incoming[q][to] for q, to, _ in self._crossings],
            leaving=[outgoing[q][at] for q, _, at in self._crossings],
        )

    def act(self, tensors: CrossTensors) -> None:
        """Copy."""
        for to, origin in zip(*tensors, strict=True):
            to.copy_(origin)

    def compile(self, example: Sequence[Tensor], key: str | None) -> None:
        """Leave it eager: its copies need no code of their own."""


class EdgeViews(NamedTuple):
    """Views ``[B, n]`` of one edge, nine each, and its profile ``[1, n + 2]``.

    ``edge`` and ``neighbour`` are incoming populations of the edge's nodes and of those next to
    them, ``outgoing`` the edge's own after collision.
    """

    edge: list[Tensor]
    neighbour: list[Tensor]
    outgoing: list[Tensor]
    profile: Tensor


class EdgeTensors(NamedTuple):
    """What sets the stream's speed, and the edges."""

    clock: Tensor
    params: FlowParams
    edges: list[EdgeViews]


class SetEdges(Part[EdgeTensors]):
    """Set the edges ``sides``, which do not depend on each other."""

    title = "edges"
    # on a GPU the stream's speed is not worth a kernel of its own
    settings = {"cuda": {"realize_reads_threshold": 16, "realize_opcount_threshold": 1000}}

    def __init__(
        self, config: FlowConfig, sides: Sequence[tuple[Side, Boundary]], device: torch.device
    ) -> None:
        super().__init__()
        self._storage, self._sides = config.storage, sides
        self._profiles = [_make_profile(config, side).to(device) for side, _ in sides]

    @property
    def name(self) -> str:
        """Key among the parts of one step."""
        return f"{super().name} {[side.name for side, _ in self._sides]}"

    def collect(self, memory: GroupMemory, parity: int) -> EdgeTensors:
        """Return the views of the edges."""
        incoming, outgoing = memory.incoming(1 - parity), memory.outgoing(parity)
        edges = [
            EdgeViews(
                edge=[f[side.edge] for f in incoming],
                neighbour=[f[side.neighbour] for f in incoming],
                outgoing=[f[side.edge] for f in outgoing],
                profile=profile,
            )
            for (side, _), profile in zip(self._sides, self._profiles, strict=True)
        ]
        return EdgeTensors(memory.flow.clock, memory.flow.params._replace(bodies=()), edges)

    def act(self, tensors: EdgeTensors) -> None:
        """Set the populations that enter at each edge."""
        speed = compute_stream_speed(tensors.params, tensors.clock).float()[:, None]
        decode, encode = self._storage.decode, self._storage.encode
        for (side, boundary), views in zip(self._sides, tensors.edges, strict=True):
            neighbour, outgoing = map(decode, views.neighbour), map(decode, views.outgoing)
            own_speed = speed * views.profile
            entering = boundary.compute_edge(side, [*neighbour], [*outgoing], own_speed)
            for q, values in entering.items():
                views.edge[q].copy_(encode(values))


def _make_profile(config: FlowConfig, side: Side) -> Tensor:
    """Return how the velocity varies along an edge, ``[1, n + 2]``, float32."""
    num_nodes = config.height if side.value[0] else config.width
    return config.boundaries.evaluate_profile(side, num_nodes)[None].to(torch.float32)


class CheckTensors(NamedTuple):
    """The result ``[B]`` bool, and incoming populations ``[B, Y, X]``."""

    is_fine: Tensor
    f: list[Tensor]


class Check(Part[CheckTensors]):
    """Flag the flows whose density or speed is out of range, or not finite."""

    title = "check"

    def __init__(self, config: FlowConfig, num_envs: int, device: torch.device) -> None:
        super().__init__()
        self._storage = config.storage
        self.is_fine = torch.zeros(num_envs, dtype=torch.bool, device=device)

    def collect(self, memory: GroupMemory, parity: int) -> CheckTensors:
        """Return all nodes."""
        return CheckTensors(self.is_fine, memory.incoming(parity))

    def act(self, tensors: CheckTensors) -> None:
        """Look at every node."""
        drho, jx, jy = compute_moments([self._storage.decode(g) for g in tensors.f])
        limit = MAX_SPEED * (drho + 1.0)
        # comparisons with NaN are false, so a broken flow is never fine
        is_node_fine = (jx * jx + jy * jy < limit * limit) & (drho.abs() < 1.0)
        tensors.is_fine.copy_(is_node_fine.flatten(1).all(-1))
