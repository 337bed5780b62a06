"""The fast step: a group of flows in one buffer, in place, compiled.

Order of one step: collide all nodes without force (one pass, 72 bytes a node), then let the bodies
act on the outgoing populations at their marker nodes alone, then set the edges. As collision
conserves mass and momentum, the bodies see the same unforced velocity as in ``solver.step``, and
the increment they add makes the result equal to the forced collision there. Even and odd steps are
the same code on other views (see ``streaming.InPlaceLayout``); states are exchanged at even
parity only.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.geometry import BodyGeometry, locate_bodies
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.boundaries import Boundary, Side
from fishrl.physics.collision import (
    collide_mrt,
    compute_force_increment,
    compute_macroscopic,
    compute_moments,
)
from fishrl.physics.fast.compiled import compile_inplace, is_own
from fishrl.physics.flow import FlowConfig, FlowParams, compute_stream_speed
from fishrl.physics.lattice import OPPOSITE, Q
from fishrl.physics.step import exchange
from fishrl.physics.storage import Storage
from fishrl.physics.streaming import InPlaceLayout

_Function = Callable[..., Any]

# A flow whose speed passes this (Mach 0.87) is beyond the method and counts as diverged.
MAX_SPEED = 0.5
_GRAPH_PAIRS = 50  # most pairs of steps in one CUDA graph
# The bodies' part is small and scatters: one thread, and weights are kept, not computed again for
# every pair of markers (six times slower at L = 100).
_BODY: dict[str, object] = {"cpp.threads": 1, "realize_opcount_threshold": 10}


class FlowData(NamedTuple):
    """All numbers of a batch of flows beside the populations, float64, every tensor ``[B, ...]``.

    Attributes:
        clock: ``[B]`` steps since reset.
        params: of the flows.
        bodies: in them.
    """

    clock: Tensor
    params: FlowParams
    bodies: tuple[BodyState, ...]


class FlowGroup:
    """The views that a step needs of one group's populations and bodies.

    Args:
        stepper: whose scratch the body part uses.
        populations: ``[num_slots]`` of the group.
        omega: ``[B, 1]`` or ``[B, cells]`` relaxation rates.
        flow: the group's numbers, views of the batch.
    """

    def __init__(
        self, stepper: "Stepper", populations: Tensor, omega: Tensor, flow: FlowData
    ) -> None:
        layout = stepper.layout
        self.populations, self.omega, self.flow = populations, omega, flow
        self.cells = [layout.cells(populations, p) for p in (0, 1)]
        self.nodes = layout.nodes(populations, 0, False)
        self.edges = [stepper.gather_edge_arguments(populations, flow, p) for p in (0, 1)]
        self.crossings = [stepper.gather_crossings(populations, p) for p in (0, 1)]
        self.body_arguments = [
            stepper.gather_body_arguments(populations, omega, flow, p) for p in (0, 1)
        ]
        self.graphs: dict[int, torch.cuda.CUDAGraph] = {}
        self.collisions = [(flow.clock, omega, *cells) for cells in self.cells]


class Stepper:
    """The functions of one step for groups of equal size, and the scratch they share.

    Args:
        config: of the flows.
        group_size: number of flows that advance together.
        sample: numbers of ``group_size`` flows, for their shapes and types.
        device: where everything lives.
    """

    def __init__(
        self, *, config: FlowConfig, group_size: int, sample: FlowData, device: torch.device
    ) -> None:
        self.config, self.device = config, device
        self.layout = InPlaceLayout(num_envs=group_size, height=config.height, width=config.width)
        self._collide = _make_collide(config)
        groups = config.boundaries.in_order()
        self._set_edges = [_make_edge_step(sides, config.storage) for sides in groups]
        self._profiles = [[self._make_profile(side) for side, _ in sides] for sides in groups]
        self._check = _make_check(config)
        self._is_fine = torch.zeros(group_size, dtype=torch.bool, device=device)
        if config.bodies:
            self._prepare_bodies(sample, group_size)

    def _make_profile(self, side: Side) -> Tensor:
        num_nodes = self.config.height if side.value[0] else self.config.width
        profile = self.config.boundaries.evaluate_profile(side, num_nodes)
        return profile[None].to(self.device, torch.float32)

    def _prepare_bodies(self, sample: FlowData, group_size: int) -> None:
        layout, device = self.layout, self.device
        self._place: BodyGeometry = locate_bodies(
            self.config, sample.params.bodies, sample.bodies, torch.float32
        )
        self._first_cell = (
            torch.arange(group_size, device=device) * layout.flow_length + layout.first_cell
        )
        self._offsets = [torch.tensor(layout.offsets(p, True), device=device) for p in (0, 1)]
        self._force = [torch.zeros(layout.num_cells, device=device) for _ in range(2)]
        trees = self._gather_trees(sample)
        self._locate = _make_locate(self.config, trees)
        self._act = _make_act(self.config, layout, trees)

    def _gather_trees(self, flow: FlowData) -> "_Trees":
        """Return bodies, shapes and, where it is kept, their place."""
        return flow.bodies, flow.params.bodies, self._place if self.config.is_still else ()

    def gather_body_arguments(
        self, populations: Tensor, omega: Tensor, flow: FlowData, parity: int
    ) -> tuple[Sequence[Tensor], ...]:
        """Return the arguments of locate and act after a step of ``parity``."""
        if not self.config.bodies:
            return ()
        everything = pytree.tree_leaves(self._gather_trees(flow))
        where = self._offsets[parity], self._first_cell
        return everything, (populations, *self._force, *where, omega, *everything)

    def gather_edge_arguments(
        self, populations: Tensor, flow: FlowData, parity: int
    ) -> list[Sequence[Tensor]]:
        """Return the arguments of the edge calls after a step of ``parity``."""
        incoming = self.layout.nodes(populations, 1 - parity, False)
        outgoing = self.layout.nodes(populations, parity, True)
        params = flow.params
        calls: list[Sequence[Tensor]] = []
        groups = self.config.boundaries.in_order()
        for sides, profiles in zip(groups, self._profiles, strict=True):
            views: list[Tensor] = []
            for side, _ in sides:
                views += [f[side.edge] for f in incoming]
                views += [f[side.neighbour] for f in incoming]
                views += [f[side.edge] for f in outgoing]
            numbers = (flow.clock, params.tau, params.stream_speed, params.ramp_steps)
            calls.append((*numbers, *profiles, *views))
        return calls

    def gather_crossings(self, populations: Tensor, parity: int) -> list[tuple[Tensor, Tensor]]:
        """Return (to, from) views of what crosses periodic edges after a step of ``parity``."""
        incoming = self.layout.nodes(populations, 1 - parity, False)
        outgoing = self.layout.nodes(populations, parity, True)
        size = self.config.height, self.config.width
        crossings = self.config.boundaries.list_crossings(*size)
        return [(incoming[q][to], outgoing[q][origin]) for q, to, origin in crossings]

    def compile(self, group: FlowGroup) -> None:
        """Compile every part of the step for groups like ``group``."""
        self._collide = self._build("collide", self._collide, group.collisions[0])
        for i, views in enumerate(group.edges[0]):
            self._set_edges[i] = self._build(f"edges {i}", self._set_edges[i], views)
        if self.config.bodies:
            locate, act = group.body_arguments[0]
            if self.config.is_still:
                self._locate = self._build("locate", self._locate, locate, **_BODY)
            self._act = self._build("act", self._act, act, **_BODY)

    def compile_check(self, group: FlowGroup) -> None:
        """Compile ``is_fine`` for groups like ``group``."""
        self._check = self._build("check", self._check, (self._is_fine, *group.nodes))

    def _build(
        self, part: str, function: _Function, example: Sequence[Tensor], **patches: object
    ) -> _Function:
        structure = self.config.get_structure()
        name = part + repr(structure) if is_own(structure) else None
        return compile_inplace(function, example, name=name, **patches)

    def is_fine(self, group: FlowGroup) -> Tensor:
        """Return ``[B]``: whether everything is finite and slower than ``MAX_SPEED``."""
        self._check(self._is_fine, *group.nodes)
        return self._is_fine.clone()

    def advance_(self, group: FlowGroup, num_steps: int) -> None:
        """Advance one group by an even number of steps."""
        if self.config.bodies and self.config.is_still:
            self._locate(*group.body_arguments[0][0])
        num_pairs = num_steps // 2
        if self.device.type == "cuda" and num_pairs:
            if not group.graphs:  # kernels are built in a first call, which cannot be captured
                self._advance_pairs_(group, 1)
                num_pairs -= 1
            while num_pairs > 0:
                self._replay_(group, min(num_pairs, _GRAPH_PAIRS))
                num_pairs -= _GRAPH_PAIRS
        else:
            self._advance_pairs_(group, num_pairs)

    def _advance_pairs_(self, group: FlowGroup, num_pairs: int) -> None:
        for _ in range(num_pairs):
            self.step_(group, 0)
            self.step_(group, 1)

    def _replay_(self, group: FlowGroup, num_pairs: int) -> None:
        """Advance by pairs of steps that are launched as one CUDA graph, recorded once."""
        if num_pairs not in group.graphs:
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph):
                self._advance_pairs_(group, num_pairs)
            group.graphs[num_pairs] = graph
        group.graphs[num_pairs].replay()

    def step_(self, group: FlowGroup, parity: int) -> None:
        """Advance one group by one step."""
        self._collide(*group.collisions[parity])
        if self.config.bodies:
            self._act(*group.body_arguments[parity][1])
        for to, origin in group.crossings[parity]:
            to.copy_(origin)
        for set_edges, arguments in zip(self._set_edges, group.edges[parity], strict=True):
            set_edges(*arguments)


def _make_collide(config: FlowConfig) -> _Function:
    """Return: collide without force; on the incoming views this streams as well."""
    storage = config.storage

    def collide(clock: Tensor, omega: Tensor, *f: Tensor) -> None:
        clock.add_(1.0)
        decoded = [storage.decode(g) for g in f]
        for q, g in enumerate(collide_mrt(decoded, omega, config.rates)):
            f[OPPOSITE[q]].copy_(storage.encode(g))

    return collide


_Trees = tuple[Any, Any, BodyGeometry | tuple[()]]


def _copy_tree(old: object, new: object) -> None:
    for a, b in zip(pytree.tree_leaves(old), pytree.tree_leaves(new), strict=True):
        a.copy_(b)


def _make_locate(config: FlowConfig, trees: _Trees) -> _Function:
    """Return: place markers and stencils of bodies that stay where they are."""
    form = pytree.tree_structure(trees)

    def locate(*leaves: Tensor) -> None:
        bodies, shapes, place = pytree.tree_unflatten(leaves, form)
        _copy_tree(place, locate_bodies(config, shapes, bodies, torch.float32))

    return locate


def _make_act(config: FlowConfig, layout: InPlaceLayout, trees: _Trees) -> _Function:
    """Return: the bodies read the fluid, move, and put their force into the populations."""
    form, storage = pytree.tree_structure(trees), config.storage

    def act(
        data: Tensor, force_x: Tensor, force_y: Tensor, offsets: Tensor, first_cell: Tensor,
        omega: Tensor, *leaves: Tensor,
    ) -> None:  # fmt: skip
        bodies, shapes, place = pytree.tree_unflatten(leaves, form)
        if not config.is_still:
            place = locate_bodies(config, shapes, bodies, torch.float32)
        nodes = place.stencil.index_nodes(layout.row_length) + first_cell[:, None, None]
        slots = [nodes + offsets[q] for q in range(Q)]
        fluid = compute_macroscopic([storage.decode(data[slot]) for slot in slots])
        moved, share_x, share_y = exchange(config, shapes, bodies, place, fluid)
        force_x.index_put_((nodes,), share_x, accumulate=True)
        force_y.index_put_((nodes,), share_y, accumulate=True)
        rates = omega[..., None]
        if config.sponges:  # each node has its own
            rates = layout.strip_rings(omega).flatten(1)
            own = place.stencil.index_nodes(config.width)
            rates = rates.gather(1, own.flatten(1)).view_as(own)
        force, share = (force_x[nodes], force_y[nodes]), (share_x, share_y)
        increment = compute_force_increment(fluid, force, share, rates, config.rates)
        for slot, values in zip(slots, increment, strict=True):
            data.index_put_((slot,), storage.encode(values), accumulate=True)
        for total in (force_x, force_y):
            total.index_put_((nodes,), torch.zeros_like(fluid.drho))
        _copy_tree(bodies, moved)

    return act


def _make_check(config: FlowConfig) -> _Function:
    """Return: look at every node of the flows."""
    storage = config.storage

    def check(is_fine: Tensor, *f: Tensor) -> None:
        drho, jx, jy = compute_moments([storage.decode(g) for g in f])
        limit = MAX_SPEED * (drho + 1.0)
        # comparisons with NaN are false, so a broken flow is never fine
        is_fine.copy_((jx * jx + jy * jy < limit * limit).flatten(1).all(-1))

    return check


def _make_edge_step(sides: list[tuple[Side, Boundary]], storage: Storage) -> _Function:
    """Return: set some edges, from the arguments of ``gather_edge_arguments``."""

    def set_edges(
        clock: Tensor, tau: Tensor, stream_speed: Tensor, ramp_steps: Tensor, *rest: Tensor
    ) -> None:
        params = FlowParams(tau, stream_speed, ramp_steps, ())
        speed_now = compute_stream_speed(params, clock).float()[:, None]
        profiles, views = rest[: len(sides)], rest[len(sides) :]
        for i, (side, boundary) in enumerate(sides):
            edge, *known = (views[(3 * i + j) * Q :][:Q] for j in range(3))
            neighbour, outgoing = ([storage.decode(f) for f in views] for views in known)
            speed = speed_now * profiles[i]
            for q, values in boundary.compute_edge(side, neighbour, outgoing, speed).items():
                edge[q].copy_(storage.encode(values))

    return set_edges
