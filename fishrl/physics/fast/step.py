"""The fast step: a group of flows in one buffer, in place, compiled.

Order of one step: collide all nodes without force (one pass, 72 bytes a node), then let the bodies
act on the outgoing populations at their marker nodes alone, then set the edges. As collision
conserves mass and momentum, the bodies see the same unforced velocity as in the readable
``step.step``, and the increment they add makes the result equal to the forced collision there. Even
and odd steps are the same code on other views (see ``layout.py``); states are exchanged at even
parity only.
"""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.boundaries import Side
from fishrl.physics.fast.compiled import Kernel, compile_inplace, is_own
from fishrl.physics.fast.coupled import make_couple, make_exchange, make_move, make_place
from fishrl.physics.fast.kernels import (
    BodyArguments,
    Exchange,
    make_bodies,
    make_check,
    make_collide,
    make_edges,
    make_locate,
)
from fishrl.physics.fast.layout import FlowData, InPlaceLayout
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import BodyGeometry, locate_bodies

_GRAPH_PAIRS = 50  # most pairs of steps in one CUDA graph
# The bodies' part is small and scatters: one thread, and weights are kept, not computed again for
# every pair of markers (six times slower at L = 100).
_BODY: dict[str, object] = {"cpp.threads": 1, "realize_opcount_threshold": 10}
# On a GPU launches count: Inductor puts kernels that do not depend on each other into one.
_GPU: dict[str, object] = {"combo_kernels": True}
# Nor is the stream's speed worth a kernel of its own.
_GPU_EDGES: dict[str, object] = {"realize_reads_threshold": 16, "realize_opcount_threshold": 1000}
# The bodies' part of each step: as tensor operations, or around the kernel for a GPU.
_BODIES = ("bodies", "place", "couple", "move")


class Scratch:
    """Constants of a step, and memory in use during a step only; all groups share it.

    ``sample`` holds the numbers of one group's flows, for their shapes and types; ``has_kernel``
    says that the bodies are coupled by the kernel for a GPU.
    """

    def __init__(
        self, config: FlowConfig, layout: InPlaceLayout, sample: FlowData, has_kernel: bool
    ) -> None:
        device = sample.clock.device
        self.is_fine = torch.zeros(layout.num_envs, dtype=torch.bool, device=device)
        self.profiles = [
            [_make_profile(config, side).to(device) for side, _ in sides]
            for sides in config.boundaries.in_order()
        ]
        self.geometry: BodyGeometry | tuple[()] = ()
        self.exchange: Exchange | tuple[()] = ()
        self.force: tuple[Tensor, ...] = ()
        if config.bodies:
            if config.is_still or has_kernel:
                geometry = locate_bodies(config, sample.params.bodies, sample.bodies, torch.float32)
                self.geometry = pytree.tree_map(_make_dense, geometry)
            if has_kernel:
                self.exchange = make_exchange(config, geometry)
            else:
                self.force = tuple(torch.zeros(layout.num_cells, device=device) for _ in range(2))
            flows = torch.arange(layout.num_envs, device=device)
            self.first_cell = flows * layout.flow_length + layout.first_cell
            self.offsets = [torch.tensor(layout.offsets(p, True), device=device) for p in (0, 1)]


class FlowGroup:
    """One group of flows that advance together: the views of its memory that a step needs.

    ``populations`` ``[num_slots]``, ``omega`` ``[B, 1]`` or ``[B, cells]`` and ``flow`` are the
    group's own part of the batch.

    Attributes:
        nodes: the nine stored populations ``[B, Y, X]`` that come in at an even step.
        arguments: of each kernel, at even and odd steps.
        crossings: (to, from) views of what crosses periodic edges, at even and odd steps.
        graphs: CUDA graphs by number of pairs of steps.
    """

    def __init__(
        self,
        *,
        config: FlowConfig,
        layout: InPlaceLayout,
        scratch: Scratch,
        populations: Tensor,
        omega: Tensor,
        flow: FlowData,
    ) -> None:
        self._storage = config.storage
        self._cells = layout.cells(populations, 0)
        self.nodes = layout.nodes(populations, 0, False)
        self.graphs: dict[int, torch.cuda.CUDAGraph] = {}
        self.arguments: dict[str, list[Sequence[Tensor]]] = {
            "collide": [(flow.clock, omega, *layout.cells(populations, p)) for p in (0, 1)],
            "check": [(scratch.is_fine, *self.nodes)],
        }
        self.crossings: list[list[tuple[Tensor, Tensor]]] = []
        for parity in (0, 1):
            incoming = layout.nodes(populations, 1 - parity, False)
            outgoing = layout.nodes(populations, parity, True)
            crossings = config.boundaries.list_crossings(config.height, config.width)
            self.crossings.append([(incoming[q][to], outgoing[q][at]) for q, to, at in crossings])
            numbers = flow.clock, *flow.params._replace(bodies=())[:-1]
            for i, sides in enumerate(config.boundaries.in_order()):
                views: list[Tensor] = []
                for side, _ in sides:
                    views += [f[side.edge] for f in incoming]
                    views += [f[side.neighbour] for f in incoming]
                    views += [f[side.edge] for f in outgoing]
                calls = self.arguments.setdefault(f"edges {i}", [])
                calls.append((*numbers, *scratch.profiles[i], *views))
        if config.bodies:
            body_calls = [
                BodyArguments(
                    data=populations,
                    force=scratch.force,
                    offsets=scratch.offsets[parity],
                    first_cell=scratch.first_cell,
                    omega=omega,
                    bodies=flow.bodies,
                    params=flow.params.bodies,
                    geometry=scratch.geometry,
                    exchange=scratch.exchange,
                )
                for parity in (0, 1)
            ]
            self.body_form = pytree.tree_structure(body_calls[0])
            leaves: list[Sequence[Tensor]] = [pytree.tree_leaves(call) for call in body_calls]
            self.arguments |= dict.fromkeys(("locate", *_BODIES), leaves)

    def read(self) -> list[Tensor]:
        """Return the nine incoming populations ``[B, Y, X]``, before an even step."""
        return [self._storage.decode(f) for f in self.nodes]

    def write_(self, rows: Tensor, f: Tensor) -> None:
        """Set the incoming populations ``[N, Q, Y, X]`` of the flows ``rows`` ``[N]``, indices."""
        for view, values in zip(self.nodes, f.unbind(1), strict=True):
            view[rows] = self._storage.encode(values)

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set all cells of the flows in ``rows`` ``[B]`` to the populations ``[B]``."""
        for view, value in zip(self._cells, f, strict=True):
            view.copy_(torch.where(rows[:, None], self._storage.encode(value[:, None]), view))


class Stepper:
    """The kernels of one step, for groups of the form of ``example``.

    Attributes:
        kernels: "collide"; where there are bodies "bodies", or "place", "couple" and "move" around
            the kernel for a GPU; "edges 0" and on, in their order; and "locate" (bodies that stay
            still, once before many steps) and "check".
    """

    def __init__(
        self, config: FlowConfig, layout: InPlaceLayout, example: FlowGroup, has_kernel: bool
    ) -> None:
        self._config, self._example = config, example
        self._device = example.nodes[0].device
        self.kernels: dict[str, Kernel] = {"collide": make_collide(config)}
        if config.bodies:
            if has_kernel:
                self.kernels["place"] = make_place(config, example.body_form)
                self.kernels["couple"] = make_couple(config, layout, example.body_form)
                self.kernels["move"] = make_move(config, example.body_form)
            else:
                self.kernels["bodies"] = make_bodies(config, layout, example.body_form)
            if config.is_still:
                self.kernels["locate"] = make_locate(config, example.body_form)
        for i, sides in enumerate(config.boundaries.in_order()):
            self.kernels[f"edges {i}"] = make_edges(sides, config.storage)
        self._inner = [name for name in self.kernels if name in ("collide", *_BODIES)]
        self._edges = [name for name in self.kernels if name.startswith("edges")]
        self.kernels["check"] = make_check(config)

    def compile(self, *names: str) -> None:
        """Compile the kernels named, or all but "check"; "couple" is compiled by Triton."""
        structure = self._config.get_structure()
        is_gpu = self._device.type == "cuda"
        options = dict.fromkeys(("locate", *_BODIES), _GPU if is_gpu else _BODY)
        if is_gpu:
            options |= dict.fromkeys(self._edges, _GPU_EDGES)
        for name in names or [n for n in self.kernels if n not in ("check", "couple")]:
            self.kernels[name] = compile_inplace(
                self.kernels[name],
                self._example.arguments[name][0],
                name=name + repr(structure) if is_own(structure) else None,
                **options.get(name, {}),
            )

    def is_fine(self, group: FlowGroup) -> Tensor:
        """Return ``[B]``: whether density and speed are within the method."""
        (arguments,) = group.arguments["check"]
        self.kernels["check"](*arguments)
        return arguments[0].clone()

    def advance_(self, group: FlowGroup, num_steps: int) -> None:
        """Advance one group by an even number of steps."""
        if "locate" in self.kernels:
            self.kernels["locate"](*group.arguments["locate"][0])
        num_pairs = num_steps // 2
        if self._device.type == "cuda" and num_pairs:
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
        with torch.cuda.device(self._device):
            if num_pairs not in group.graphs:
                graph = torch.cuda.CUDAGraph()
                with torch.cuda.graph(graph):
                    self._advance_pairs_(group, num_pairs)
                group.graphs[num_pairs] = graph
            group.graphs[num_pairs].replay()

    def step_(self, group: FlowGroup, parity: int) -> None:
        """Advance one group by one step."""
        kernels, arguments = self.kernels, group.arguments
        for name in self._inner:
            kernels[name](*arguments[name][parity])
        for to, origin in group.crossings[parity]:
            to.copy_(origin)
        for edges in self._edges:
            kernels[edges](*arguments[edges][parity])


def _make_dense(t: Tensor) -> Tensor:
    """Return a copy without gaps or repeats in memory."""
    return t.clone(memory_format=torch.contiguous_format)


def _make_profile(config: FlowConfig, side: Side) -> Tensor:
    """Return how the velocity varies along an edge, ``[1, n + 2]``, float32."""
    num_nodes = config.height if side.value[0] else config.width
    return config.boundaries.evaluate_profile(side, num_nodes)[None].to(torch.float32)
