"""The fast step: a group of flows in one buffer, in place, compiled.

Order of one step: collide all nodes without force (one pass, 72 bytes a node), then let the fish
act on the outgoing populations at its marker nodes alone, then set the edges. As collision
conserves mass and momentum, the fish sees the same unforced velocity as in ``solver.step``, and
the increment it adds makes the result equal to the forced collision there. Even and odd steps are
the same code on other views (see ``streaming.InPlaceLayout``); states are exchanged at even
parity only.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from fishrl.physics.boundaries import Boundary, Side
from fishrl.physics.collision import collide_mrt, compute_force_increment, compute_macroscopic
from fishrl.physics.compiled import compile_inplace
from fishrl.physics.immersed_boundary import Stencil
from fishrl.physics.kinematics import Deformation, Modes
from fishrl.physics.lattice import OPPOSITE, Q
from fishrl.physics.rigid_motion import Body, Markers, make_body, move_body
from fishrl.physics.solver import Place, exchange, locate_body
from fishrl.physics.state import FlowConfig
from fishrl.physics.streaming import InPlaceLayout

_Function = Callable[..., Any]
_NUM_BODY, _NUM_MODES = len(Body._fields), len(Modes._fields)


class FlowGroup:
    """The views that a step needs of one group's populations and bodies.

    Args:
        stepper: whose scratch the body part uses.
        data: ``[num_slots]`` the group's populations.
        body: the group's bodies, views of the batch.
    """

    def __init__(self, stepper: "Stepper", data: Tensor, body: Body) -> None:
        layout, config = stepper.layout, stepper.config
        self.data, self.body = data, body
        self.cells = [layout.cells(data, p) for p in (0, 1)]
        self.edges = [_make_edge_views(layout, data, config, p) for p in (0, 1)]
        self.body_arguments = [stepper.gather_body_arguments(data, body, p) for p in (0, 1)]


class Stepper:
    """The functions of one step for groups of equal size, and the scratch they share.

    Args:
        config: of the flows.
        group_size: number of flows that advance together.
        device: where everything lives.
    """

    def __init__(self, *, config: FlowConfig, group_size: int, device: torch.device) -> None:
        self.config, self.device = config, device
        self.layout = InPlaceLayout(num_envs=group_size, height=config.height, width=config.width)
        self._omega = torch.full((group_size, 1), 1.0 / config.tau, device=device)
        self._collide = _make_collide(config)
        self._set_edges = [_make_edge_step(sides) for sides in config.boundaries.in_order()]
        self.modes = None if config.fish is None else config.fish.make_modes(device)
        if self.modes is not None:
            self._prepare_body(self.modes, group_size)

    def _prepare_body(self, modes: Modes, group_size: int) -> None:
        layout, device = self.layout, self.device
        flows = torch.arange(group_size, device=device)
        rest = torch.zeros(group_size, dtype=torch.float64, device=device)
        sample = make_body(torch.zeros_like(rest)[:, None].expand(-1, 2), rest, rest)
        self._place = _flatten(locate_body(sample, self.config, modes, torch.float32))
        entries = _unflatten(self._place).stencil.weights.numel()
        self._first_cell = flows * layout.flow_length + layout.first_cell
        self._offsets = [torch.tensor(layout.offsets(p, True), device=device) for p in (0, 1)]
        self._force = torch.zeros(2 * layout.num_cells, device=device)
        self._nodes = torch.zeros(2 * entries, dtype=torch.int64, device=device)
        self._shares = torch.zeros(2 * entries, device=device)
        self._fluid = torch.zeros(3, entries, device=device)
        self._slots = torch.zeros(Q * entries, dtype=torch.int64, device=device)
        self._increments = torch.zeros(Q * entries, device=device)
        self._entry_omega = self._omega.expand(-1, entries // group_size).reshape(-1).clone()
        self._locate = _make_locate(self.config)
        self._push = _make_push(self.config, layout)
        self._absorb = _make_absorb(self.config)

    def gather_body_arguments(
        self, data: Tensor, body: Body, parity: int
    ) -> tuple[Sequence[Tensor], ...]:
        """Return the arguments of locate, push and absorb after a step of ``parity``."""
        if self.modes is None:
            return ()
        offsets, scratch = self._offsets[parity], (self._nodes, self._shares, self._fluid)
        return (
            (*body, *self.modes, *self._place),
            (data, offsets, self._first_cell, *scratch, *body, *self._place),
            (self._force, *scratch, self._entry_omega, offsets, self._slots, self._increments),
        )

    def compile(self, group: FlowGroup) -> None:
        """Compile every part of the step for groups like ``group``."""
        self._collide = compile_inplace(self._collide, (self._omega, *group.cells[0]))
        for i, views in enumerate(group.edges[0]):
            self._set_edges[i] = compile_inplace(self._set_edges[i], views)
        if self.modes is not None:
            locate, push, absorb = group.body_arguments[0]
            self._locate = compile_inplace(self._locate, locate)
            self._push = compile_inplace(self._push, push)
            self._absorb = compile_inplace(self._absorb, absorb)

    def step_(self, group: FlowGroup, parity: int) -> None:
        """Advance one group by one step of ``parity``."""
        self._collide(self._omega, *group.cells[parity])
        if self.modes is not None:
            locate, push, absorb = group.body_arguments[parity]
            self._locate(*locate)
            self._push(*push)
            self._force.index_add_(0, self._nodes, self._shares)
            self._absorb(*absorb)
            group.data.index_add_(0, self._slots, self._increments)
            self._force.index_fill_(0, self._nodes, 0.0)
        for set_edges, views in zip(self._set_edges, group.edges[parity], strict=True):
            set_edges(*views)


def _make_collide(config: FlowConfig) -> _Function:
    """Return: collide without force; on the incoming views this streams as well."""

    def collide(omega: Tensor, *f: Tensor) -> None:
        for q, g in enumerate(collide_mrt(f, omega, config.rates)):
            f[OPPOSITE[q]].copy_(g)

    return collide


def _make_locate(config: FlowConfig) -> _Function:
    """Return: deform the body, place markers and stencils."""

    def locate(*args: Tensor) -> None:
        body, rest = Body(*args[:_NUM_BODY]), args[_NUM_BODY:]
        place = locate_body(body, config, Modes(*rest[:_NUM_MODES]), torch.float32)
        for old, new in zip(rest[_NUM_MODES:], _flatten(place), strict=True):
            old.copy_(new)

    return locate


def _make_push(config: FlowConfig, layout: InPlaceLayout) -> _Function:
    """Return: markers read the fluid, force and motion are solved, the body moves."""

    def push(
        data: Tensor, offsets: Tensor, first_cell: Tensor,
        nodes_out: Tensor, shares_out: Tensor, fluid_out: Tensor, *rest: Tensor,
    ) -> None:  # fmt: skip
        body, place = Body(*rest[:_NUM_BODY]), _unflatten(rest[_NUM_BODY:])
        nodes = place.stencil.index_nodes(layout.row_length) + first_cell[:, None, None]
        rho, jx, jy = compute_macroscopic([data[nodes + offsets[q]] for q in range(Q)])
        ux, uy = jx / (rho + 1.0), jy / (rho + 1.0)
        result, share_x, share_y = exchange(body, config, place, rho, ux, uy)
        flat = nodes.reshape(-1)
        nodes_out.copy_(torch.cat((flat, flat + layout.num_cells)))
        shares_out.copy_(torch.cat((share_x.reshape(-1), share_y.reshape(-1))))
        fluid_out.copy_(torch.stack((rho, ux, uy)).reshape(3, -1))
        for old, new in zip(body, move_body(body, place.shape, result), strict=True):
            old.copy_(new)

    return push


def _make_absorb(config: FlowConfig) -> _Function:
    """Return: from the nodes' total force, what each marker adds to the populations."""

    def absorb(
        force: Tensor, nodes: Tensor, shares: Tensor, fluid: Tensor, omega: Tensor,
        offsets: Tensor, slots_out: Tensor, increments_out: Tensor,
    ) -> None:  # fmt: skip
        fx, fy = force[nodes].chunk(2)
        part_x, part_y = shares.chunk(2)
        rho, ux, uy = fluid.unbind(0)
        increment = compute_force_increment(
            rho, ux, uy, fx, fy, part_x, part_y, omega, config.rates
        )
        increments_out.copy_(torch.cat(increment))
        slots_out.copy_((offsets[:, None] + nodes.chunk(2)[0]).reshape(-1))

    return absorb


def _make_edge_views(
    layout: InPlaceLayout, data: Tensor, config: FlowConfig, parity: int
) -> list[Sequence[Tensor]]:
    """Return the views that the edge calls read and write after a step of ``parity``."""
    incoming = layout.nodes(data, 1 - parity, False)
    outgoing = layout.nodes(data, parity, True)
    calls: list[Sequence[Tensor]] = []
    for sides in config.boundaries.in_order():
        views: list[Tensor] = []
        for side, _ in sides:
            views += [f[side.edge] for f in incoming]
            views += [f[side.neighbour] for f in incoming]
            views += [f[side.edge] for f in outgoing]
        calls.append(views)
    return calls


def _make_edge_step(sides: list[tuple[Side, Boundary]]) -> _Function:
    """Return: set some edges, from views in the order of ``_make_edge_views``."""

    def set_edges(*views: Tensor) -> None:
        for i, (side, boundary) in enumerate(sides):
            edge, neighbour, outgoing = (views[(3 * i + j) * Q :][:Q] for j in range(3))
            for q, values in boundary.compute_edge(side, neighbour, outgoing).items():
                edge[q].copy_(values)

    return set_edges


def _flatten(place: Place) -> list[Tensor]:
    return [t for part in place for t in part]


def _unflatten(tensors: Sequence[Tensor]) -> Place:
    shape, markers = len(Deformation._fields), len(Markers._fields)
    return Place(
        Deformation(*tensors[:shape]),
        Markers(*tensors[shape : shape + markers]),
        Stencil(*tensors[shape + markers :]),
    )
