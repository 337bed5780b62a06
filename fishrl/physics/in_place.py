"""The fast step: the whole batch in one buffer, in place, compiled.

Order of one step: collide all nodes without force (one pass, 72 bytes a node), then let the fish act
on the outgoing populations at its marker nodes alone, then set the edges. As collision conserves mass
and momentum, the fish sees the same unforced velocity as in ``solver.step``, and the increment it adds
makes the result equal to the forced collision there. Even and odd steps are the same code on other
views (see ``streaming.InPlaceBuffer``); states are exchanged at even parity only.
"""

import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from fishrl.physics.boundaries import Side
from fishrl.physics.collision import collide_mrt, compute_force_increment, compute_macroscopic
from fishrl.physics.compiled import compile_inplace
from fishrl.physics.kinematics import Modes, deform
from fishrl.physics.lattice import OPPOSITE, Q
from fishrl.physics.rigid_motion import Body, make_body, move_body, place_markers
from fishrl.physics.solver import exchange, locate_body
from fishrl.physics.state import FlowConfig
from fishrl.physics.streaming import InPlaceBuffer

logger = logging.getLogger(__name__)

# A flow whose speed passes this (Mach 0.87) is beyond the method and counts as diverged.
MAX_SPEED = 0.5


class InPlaceSolver:
    """A batch of flows, each with a fish, advanced in place.

    Args:
        config: of the flows.
        num_envs: number of flows B.
        frequency: tail beats per step at start.
        device: where everything lives.
        compile: compile the step; otherwise the same functions run eagerly.
    """

    def __init__(
        self,
        *,
        config: FlowConfig,
        num_envs: int,
        frequency: float = 0.0,
        device: torch.device | str = "cpu",
        compile: bool = True,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs}: at least one flow is needed")
        if config.boundaries.is_periodic:
            raise ValueError(
                "the in-place step has no periodic edges: use fishrl.physics.solver.step for them"
            )
        self.config, self.num_envs, self.device = config, num_envs, torch.device(device)
        self.buffer = InPlaceBuffer(
            num_envs=num_envs, height=config.height, width=config.width, device=device
        )
        self._omega = torch.full((num_envs, 1), 1.0 / config.tau, device=device)
        rest = torch.zeros(num_envs, dtype=torch.float64, device=device)
        centre = torch.tensor([0.5 * config.width, 0.5 * config.height], dtype=torch.float64)
        self.body: Body = _own(
            make_body(centre.to(device).expand(num_envs, 2), rest, rest + frequency)
        )
        self._frequency = frequency
        self._modes: Modes | None = None
        self._views = [self.buffer.cells(p) for p in (0, 1)]
        self._edges = [_make_edge_views(self.buffer, config, p) for p in (0, 1)]
        self._collide: Callable[..., Any] = self._make_collide()
        self._set_edges = [_make_edge_step(config, pair) for pair in (0, 1)]
        if config.fish is not None:
            self._prepare_body()
        self._is_compiled = not compile

    def _make_collide(self) -> Callable[..., None]:
        rates = self.config.rates

        def collide(omega: Tensor, *f: Tensor) -> None:
            for q, g in enumerate(collide_mrt(f, omega, rates)):
                f[OPPOSITE[q]].copy_(g)

        return collide

    def _prepare_body(self) -> None:
        """Set up what the fish's part of the step reads and writes."""
        config, buffer = self.config, self.buffer
        assert config.fish is not None
        self._modes = config.fish.make_modes(self.device)
        kernel = config.kernel.support**2
        entries = self.num_envs * config.fish.num_markers * kernel
        flows = torch.arange(self.num_envs, device=self.device)
        self._first_cell = flows * buffer.flow_length + buffer.first_cell
        self._offsets = [
            torch.tensor(buffer.offsets(p, True), device=self.device) for p in (0, 1)
        ]
        self._force = torch.zeros(2 * buffer.num_cells, device=self.device)
        self._cells = torch.zeros(2 * entries, dtype=torch.int64, device=self.device)
        self._shares = torch.zeros(2 * entries, device=self.device)
        self._fluid = torch.zeros(3, entries, device=self.device)
        self._slots = torch.zeros(Q * entries, dtype=torch.int64, device=self.device)
        self._increments = torch.zeros(Q * entries, device=self.device)
        self._entry_omega = (
            self._omega.expand(self.num_envs, entries // self.num_envs).reshape(-1).clone()
        )
        self._push = self._make_push()
        self._absorb = self._make_absorb()

    def _make_push(self) -> Callable[..., None]:
        """Return: markers read the fluid, force and motion are solved, the body moves."""
        config, modes, buffer = self.config, self._modes, self.buffer
        assert modes is not None
        num_fields = len(Body._fields)

        def push(
            flat: Tensor, offsets: Tensor, first_cell: Tensor,
            cells_out: Tensor, shares_out: Tensor, fluid_out: Tensor, *rest: Tensor,
        ) -> None:  # fmt: skip
            body, gait = Body(*rest[:num_fields]), Modes(*rest[num_fields:])
            place = locate_body(body, config, gait, flat.dtype)
            cells = place.stencil.index_nodes(buffer.row_length) + first_cell[:, None, None]
            f = [flat[cells + offsets[q]] for q in range(Q)]
            rho, jx, jy = compute_macroscopic(f)
            ux, uy = jx / (rho + 1.0), jy / (rho + 1.0)
            result, share_x, share_y = exchange(body, config, gait, place, rho, ux, uy)
            flat_cells = cells.reshape(-1)
            cells_out.copy_(torch.cat((flat_cells, flat_cells + buffer.num_cells)))
            shares_out.copy_(torch.cat((share_x.reshape(-1), share_y.reshape(-1))))
            fluid_out.copy_(torch.stack((rho, ux, uy)).reshape(3, -1))
            for old, new in zip(body, move_body(body, place.shape, result), strict=True):
                old.copy_(new)

        return push

    def _make_absorb(self) -> Callable[..., None]:
        """Return: from the nodes' total force, what each marker adds to the populations."""
        config = self.config

        def absorb(
            force: Tensor, cells: Tensor, shares: Tensor, fluid: Tensor, omega: Tensor,
            offsets: Tensor, slots_out: Tensor, increments_out: Tensor,
        ) -> None:  # fmt: skip
            fx, fy = force[cells].chunk(2)
            part_x, part_y = shares.chunk(2)
            rho, ux, uy = fluid.unbind(0)
            increment = compute_force_increment(
                rho, ux, uy, fx, fy, part_x, part_y, omega, config.rates
            )
            increments_out.copy_(torch.cat(increment))
            slots_out.copy_((offsets[:, None] + cells.chunk(2)[0]).reshape(-1))

        return absorb

    def _body_arguments(self, parity: int) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        assert self._modes is not None
        offsets = self._offsets[parity]
        push = (
            self.buffer.flat, offsets, self._first_cell, self._cells, self._shares, self._fluid,
            *self.body, *self._modes,
        )  # fmt: skip
        absorb = (
            self._force, self._cells, self._shares, self._fluid, self._entry_omega, offsets,
            self._slots, self._increments,
        )  # fmt: skip
        return push, absorb

    def compile(self) -> None:
        """Compile the step now; the first ``advance_`` does it otherwise."""
        if self._is_compiled:
            return
        self._is_compiled = True
        start = time.perf_counter()
        logger.info("compiling the flow step (once per shape, up to a minute) ...")
        self._collide = compile_inplace(self._collide, (self._omega, *self._views[0]))
        for pair in (0, 1):
            self._set_edges[pair] = compile_inplace(self._set_edges[pair], self._edges[0][pair])
        if self._modes is not None:
            push, absorb = self._body_arguments(0)
            self._push = compile_inplace(self._push, push)
            self._absorb = compile_inplace(self._absorb, absorb)
        logger.info("compiled in %.1f s", time.perf_counter() - start)

    def advance_(self, num_steps: int) -> None:
        """Advance all flows by an even number of steps."""
        if num_steps < 0 or num_steps % 2:
            raise ValueError(f"num_steps = {num_steps}: must be even and not negative")
        self.compile()
        for _ in range(num_steps // 2):
            self._step_(0)
            self._step_(1)

    def _step_(self, parity: int) -> None:
        self._collide(self._omega, *self._views[parity])
        if self._modes is not None:
            push, absorb = self._body_arguments(parity)
            self._push(*push)
            self._force.index_add_(0, self._cells, self._shares)
            self._absorb(*absorb)
            self.buffer.flat.index_add_(0, self._slots, self._increments)
            self._force.index_fill_(0, self._cells, 0.0)
        for pair in (0, 1):
            self._set_edges[pair](*self._edges[parity][pair])

    def reset_(self, rows: Tensor, position: Tensor, heading: Tensor) -> None:
        """Put the fish of some flows at rest into still water; other rows are not touched.

        Args:
            rows: ``[B]`` bool, which flows.
            position: ``[B, 2]`` centre of mass in nodes, for the rows given.
            heading: ``[B]`` direction that the fish faces, radians.
        """
        if rows.shape != (self.num_envs,) or rows.dtype != torch.bool:
            raise ValueError(
                f"rows has shape {tuple(rows.shape)} and type {rows.dtype}: give a bool tensor of "
                f"shape ({self.num_envs},)"
            )
        position, heading = position.double(), heading.double()
        fresh = make_body(position, heading, torch.full_like(heading, self._frequency))
        for old, new in zip(self.body, fresh, strict=True):
            mask = rows.view(-1, *(1,) * (old.dim() - 1))
            old.copy_(torch.where(mask, new, old))
        self._write(torch.zeros((), device=self.device), rows)

    def _write(self, values: Tensor, rows: Tensor) -> None:
        """Set incoming populations (even parity) of some rows, rings included for zeros."""
        views = self._views[0] if values.dim() == 0 else self.buffer.nodes(0, False)
        for q, view in enumerate(views):
            new = values if values.dim() == 0 else values[:, q]
            view.copy_(torch.where(rows.view(-1, *(1,) * (view.dim() - 1)), new, view))

    def set_populations_(self, f: Tensor) -> None:
        """Set all flows to populations ``[B, Q, Y, X]`` (shifted)."""
        self._write(f, torch.ones(self.num_envs, dtype=torch.bool, device=self.device))

    def command_(self, turn: Tensor, num_steps: int, frequency: Tensor | None = None) -> None:
        """Order a turn and, optionally, a new tail-beat frequency.

        Args:
            turn: ``[B]`` change of heading, radians, spread smoothly over ``num_steps``.
            num_steps: length of the turn.
            frequency: ``[B]`` tail beats per step; the phase stays continuous.
        """
        if num_steps < 1:
            raise ValueError(f"num_steps = {num_steps}: a turn takes at least one step")
        self.body.turn.copy_(turn)
        self.body.turn_steps.fill_(float(num_steps))
        self.body.turn_clock.zero_()
        if frequency is not None:
            self.body.frequency.copy_(frequency)

    def populations(self) -> Tensor:
        """Return a copy of the incoming populations ``[B, Q, Y, X]`` (shifted)."""
        return torch.stack(self.buffer.nodes(0, False), 1)

    def macroscopic(self) -> tuple[Tensor, Tensor]:
        """Return density ``[B, Y, X]`` and velocity ``[B, 2, Y, X]``."""
        rho, jx, jy = compute_macroscopic(self.buffer.nodes(0, False))
        density = rho + 1.0
        return density, torch.stack((jx / density, jy / density), 1)

    def markers(self) -> Tensor:
        """Return the closed outline ``[B, N, 2]`` in nodes, nose first."""
        if self._modes is None:
            raise ValueError("this flow has no fish: give FlowConfig a fish")
        body = self.body
        shape = deform(self._modes, body.phase, body.frequency, body.age)
        return place_markers(body, self._modes, shape).position

    def head(self) -> Tensor:
        """Return the nose ``[B, 2]`` in nodes."""
        return self.markers()[:, 0]

    def is_diverged(self) -> Tensor:
        """Return ``[B]``: not finite, too fast for the method, or the fish outside the grid."""
        _, u = self.macroscopic()
        # comparisons with NaN are false, so a broken flow is never "fine"
        fine = ((u * u).sum(1) < MAX_SPEED**2).all(-1).all(-1)
        if self._modes is not None:
            markers = self.markers()
            size = torch.tensor([self.config.width, self.config.height], device=self.device)
            inside = (markers > 0.5) & (markers < size - 1.5)
            fine = fine & inside.all(-1).all(-1)
        return ~fine

    def state_dict(self) -> dict[str, Tensor]:
        """Return everything that the future depends on, as copies."""
        return {"buffer": self.buffer.data.clone()} | {
            name: t.clone() for name, t in zip(Body._fields, self.body, strict=True)
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore ``state_dict()`` exactly."""
        for name, own in [("buffer", self.buffer.data), *zip(Body._fields, self.body, strict=True)]:
            if name not in state or state[name].shape != own.shape:
                got = tuple(state[name].shape) if name in state else "nothing"
                raise ValueError(
                    f"state '{name}' has shape {got}, expected {tuple(own.shape)}: it was saved by "
                    "a solver of another grid, batch or version"
                )
            own.copy_(state[name])


def _own(body: Body) -> Body:
    """Give every field storage of its own."""
    return Body(*(t.clone().contiguous() for t in body))


def _make_edge_views(
    buffer: InPlaceBuffer, config: FlowConfig, parity: int
) -> list[Sequence[Tensor]]:
    """Return the views that an edge call reads and writes after a step of ``parity``."""
    incoming = buffer.nodes(1 - parity, False)
    outgoing = buffer.nodes(parity, True)
    calls: list[Sequence[Tensor]] = []
    for pair in config.boundaries.by_side():
        views = []
        for side, _ in pair:
            for fields, index in (
                (incoming, side.edge), (incoming, side.neighbour), (outgoing, side.edge)
            ):  # fmt: skip
                views += [f[index] for f in fields]
        calls.append(views)
    return calls


def _make_edge_step(config: FlowConfig, pair: int) -> Callable[..., None]:
    """Return the function that sets two opposite edges from views in that order."""
    sides: tuple[tuple[Side, Any], ...] = config.boundaries.by_side()[pair]

    def set_edges(*views: Tensor) -> None:
        for i, (side, boundary) in enumerate(sides):
            edge, neighbour, outgoing = (views[(3 * i + j) * Q :][:Q] for j in range(3))
            for q, values in boundary.compute_edge(side, neighbour, outgoing).items():
                edge[q].copy_(values)

    return set_edges
