"""A batch of flows in memory: what environments hold, reset, command, advance and read."""

import logging
import time
from collections.abc import Collection, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.geometry import Markers, deform_body, locate_markers, place_markers
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.collision import compute_equilibrium, compute_macroscopic
from fishrl.physics.fast.compiled import find_compiler_problem
from fishrl.physics.fast.memory import FlowMemory
from fishrl.physics.fast.probes import sample_flow, spread_starts
from fishrl.physics.fast.step import FlowData, FlowGroup, Stepper
from fishrl.physics.fast.workers import SharedMemory, Workers, count_cores, map_shared
from fishrl.physics.flow import FlowConfig, list_configs, make_params

logger = logging.getLogger(__name__)


class InPlaceSolver:
    """A batch of flows and the bodies in them, advanced in place.

    Args:
        config: of all flows, or one configuration per flow; see ``FlowConfig`` for what may differ.
        num_envs: number of flows B; with one configuration per flow it may be left out.
        frequency: tail beats or oscillations per step at start, of all bodies; ``[B]`` or a number.
        device: where everything lives.
        compile: compile the step; otherwise the same functions run eagerly.
        num_workers: CPU processes that share the flows, each on one core. None takes one per core,
            at most one per flow, where the step is compiled; 0 runs all flows here, each on all of
            torch's threads, which is faster for a single large flow on a quiet machine and much
            slower on a busy one. On a GPU it must be 0.
        flows_per_launch: flows that each pass over memory advances together; a divisor of B. None
            is one on a CPU, whose cache holds a flow, and all on a GPU.
    """

    def __init__(
        self,
        *,
        config: FlowConfig | Sequence[FlowConfig],
        num_envs: int | None = None,
        frequency: float | Tensor = 0.0,
        device: torch.device | str = "cpu",
        compile: bool = True,
        num_workers: int | None = None,
        flows_per_launch: int | None = None,
    ) -> None:
        configs = list_configs(config, num_envs)
        num_envs = len(configs)
        device = torch.device(device)
        is_cpu = device.type == "cpu"
        torch.set_flush_denormal(True)  # still water decays into denormals, which are slow
        if num_workers is None:
            can_share = is_cpu and compile and not find_compiler_problem("cpu")
            num_workers = min(count_cores(), num_envs) if can_share else 0
        if num_workers < 0 or (num_workers and not is_cpu):
            raise ValueError(
                f"num_workers = {num_workers} on {device}: allowed is 0 on a GPU, 0 or more "
                "on a CPU"
            )
        self._workers: Workers | None = None
        self._frequency = torch.as_tensor(frequency, dtype=torch.float64, device=device)
        self._is_closed = self._is_ready = False
        size = flows_per_launch or (1 if is_cpu else num_envs)
        if size < 1 or num_envs % size:
            raise ValueError(
                f"flows_per_launch = {flows_per_launch}: must divide the number of flows {num_envs}"
            )
        self._num_workers = min(num_workers, num_envs // size)
        fresh = self._prepare(configs, device, compile, size)
        num_bytes = self._memory.count_bytes()
        self._shared = SharedMemory(num_bytes) if self._num_workers else None
        if self._shared is None:
            memory = torch.zeros(num_bytes, dtype=torch.uint8, device=device)
        else:
            memory = self._shared.tensor
        self._bind(memory, range(num_envs // self._stepper.layout.num_envs))
        for own, new in zip(pytree.tree_leaves(self.flow), pytree.tree_leaves(fresh), strict=True):
            own.copy_(new)
        self._fill_omega()

    def _prepare(
        self, configs: Sequence[FlowConfig], device: torch.device, compile: bool, size: int
    ) -> FlowData:
        """Make the stepper and return the numbers that flows begin with."""
        self.configs, self.config = list(configs), configs[0]
        self.num_envs, self.device, self._wants_compile = len(configs), device, compile
        params = make_params(configs, device)
        centre = torch.tensor([0.5 * self.config.width, 0.5 * self.config.height]).double()
        rest = torch.zeros(self.num_envs, dtype=torch.float64, device=device)
        place = centre.to(device).expand(self.num_envs, 2)
        body = make_body(place, rest, rest + self._frequency)
        fresh = FlowData(rest, params, tuple(body for _ in self.config.bodies))
        sample = pytree.tree_map(lambda t: t[:size], fresh)
        self._stepper = Stepper(config=self.config, group_size=size, sample=sample, device=device)
        self._memory = FlowMemory(
            fresh,
            self._stepper.layout,
            dtype=self.config.storage.dtype,
            has_omega_field=bool(self.config.sponges),
        )
        return fresh

    @classmethod
    def attach(
        cls, *, configs: Sequence[FlowConfig], path: str, groups: range, compile: bool, size: int
    ) -> "InPlaceSolver":
        """Return a worker's solver, which advances ``groups`` of a batch in shared memory."""
        self = cls.__new__(cls)
        self._workers, self._num_workers, self._shared = None, 0, None
        self._is_closed = self._is_ready = False
        self._frequency = torch.zeros((), dtype=torch.float64)
        self._prepare(configs, torch.device("cpu"), compile, size)
        self._bind(map_shared(path, self._memory.count_bytes()), groups)
        if compile:
            self._stepper.compile(next(iter(self._groups.values())))
        return self

    def _bind(self, memory: Tensor, groups: range) -> None:
        """Lay everything out in ``memory`` and make the views of some groups."""
        size = self._stepper.layout.num_envs
        self.flow, self._omega, self._data = self._memory.carve(memory)
        self._groups = {
            g: FlowGroup(
                self._stepper,
                self._data[g],
                self._omega[g * size : (g + 1) * size],
                pytree.tree_map(lambda t: t[g * size : (g + 1) * size], self.flow),  # noqa: B023
            )
            for g in groups
        }

    def _fill_omega(self) -> None:
        """Write the relaxation rates that the flows' tau and sponges give."""
        omega = self.config.compute_omega(self.flow.params.tau)
        if omega.shape[1:] == (1, 1):
            self._omega.copy_(omega[:, 0])
        else:
            layout = self._stepper.layout
            self._omega.fill_(1.0)
            layout.strip_rings(self._omega).copy_(omega)

    @property
    def bodies(self) -> tuple[BodyState, ...]:
        """The bodies' states, in the order of the configuration; tensors change in place."""
        return self.flow.bodies

    @property
    def body(self) -> BodyState:
        """The first body's state, the fish where there is one."""
        if not self.flow.bodies:
            raise ValueError("this flow has no body: give FlowConfig(bodies=...)")
        return self.flow.bodies[0]

    def compile(self) -> None:
        """Compile the step and start the workers; the first ``advance_`` does it otherwise."""
        if self._is_ready or not (self._num_workers or self._wants_compile):
            return
        start = time.perf_counter()
        logger.info("compiling the flow step (up to a minute when new) ...")
        first = next(iter(self._groups.values()))
        if self._num_workers:
            self._start_workers()
        else:
            self._stepper.compile(first)
        if self._wants_compile:
            self._stepper.compile_check(first)
        self._is_ready = True
        logger.info("flow step ready after %.1f s", time.perf_counter() - start)

    def _start_workers(self) -> None:
        assert self._shared is not None
        job = {
            "configs": self.configs,
            "path": str(self._shared.path),
            "compile": self._wants_compile,
            "size": self._stepper.layout.num_envs,
            "log_level": logging.WARNING,
        }
        num, count = len(self._groups), self._num_workers
        self._workers = Workers([job | {"groups": range(w, num, count)} for w in range(count)])
        self._shared.unlink()

    def close(self) -> None:
        """End the workers, if any; the flows can still be read."""
        self._is_closed = True
        if self._workers is not None:
            self._workers.close()
        if self._shared is not None:
            self._shared.unlink()

    def advance_(self, num_steps: int, rows: Tensor | None = None) -> None:
        """Advance the flows by an even number of steps.

        Args:
            num_steps: how many.
            rows: ``[B]`` bool, the flows that must advance, or None for all. What happens to the
                others is not said: those that share no launch with a row that must are left alone.
        """
        if num_steps < 0 or num_steps % 2:
            raise ValueError(f"num_steps = {num_steps}: must be even and not negative")
        if self._is_closed:
            raise RuntimeError("this solver is closed and cannot advance: make a new one")
        self.compile()
        wanted = torch.ones(self.num_envs, dtype=torch.bool) if rows is None else rows
        groups = wanted.view(-1, self._stepper.layout.num_envs).any(-1).nonzero()[:, 0].tolist()
        if self._workers is not None:
            self._workers.advance_(num_steps, groups)
        else:
            self.advance_groups_(num_steps, groups)

    def advance_groups_(self, num_steps: int, wanted: Collection[int]) -> None:
        """Advance those of this process's groups that are wanted."""
        for index, group in self._groups.items():
            if index in wanted:
                self._stepper.advance_(group, num_steps)

    def reset_(
        self,
        rows: Tensor,
        position: Tensor | None = None,
        heading: Tensor | None = None,
        *,
        velocity: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Put the bodies of some flows at rest into a fluid without vortices.

        Args:
            rows: ``[B]`` bool, which flows; others are not touched.
            position: centre of mass in nodes, ``[B, 2]`` or for several bodies ``[B, M, 2]``, read
                where ``rows`` is true; None is the middle of the domain.
            heading: direction that the nose faces, radians, ``[B]`` or ``[B, M]``; None is 0.
            velocity: of the fluid everywhere, in units of the stream speed.
        """
        if rows.shape != (self.num_envs,) or rows.dtype != torch.bool:
            raise ValueError(
                f"rows has shape {tuple(rows.shape)} and type {rows.dtype}: give a bool tensor of "
                f"shape ({self.num_envs},)"
            )
        num_bodies = len(self.bodies)
        position, heading = spread_starts(
            position, heading, self.config, self.num_envs, self.device
        )
        fresh = []
        for m in range(num_bodies):
            frequency = torch.zeros_like(heading[:, m]) + self._frequency
            fresh.append(make_body(position[:, m], heading[:, m], frequency))
        new_data = self.flow._replace(clock=torch.zeros_like(self.flow.clock), bodies=tuple(fresh))
        for old, new in zip(
            pytree.tree_leaves(self.flow), pytree.tree_leaves(new_data), strict=True
        ):
            old.copy_(torch.where(rows.view(-1, *(1,) * (old.dim() - 1)), new, old))
        speed = self.flow.params.stream_speed.float()
        at_rest = torch.zeros_like(speed)
        start = compute_equilibrium(at_rest, velocity[0] * speed, velocity[1] * speed)
        size = self._stepper.layout.num_envs
        for index, group in self._groups.items():
            mine = slice(index * size, (index + 1) * size)
            mask = rows[mine]
            if size > 1 or mask.item():
                for f, value in zip(group.cells[0], start, strict=True):
                    stored = self.config.storage.encode(value[mine, None])
                    f.copy_(torch.where(mask[:, None], stored, f))

    @property
    def stream_speed(self) -> Tensor:
        """Stream speed of each flow ``[B]``, nodes per step; change it by ``set_stream_speed_``."""
        return self.flow.params.stream_speed

    def set_stream_speed_(self, speed: Tensor, rows: Tensor | None = None) -> None:
        """Set the stream speed of all flows, or of those in ``rows`` ``[B]``, nodes per step."""
        own = self.flow.params.stream_speed
        own.copy_(speed if rows is None else torch.where(rows, speed, own))

    def set_populations_(self, f: Tensor, rows: Tensor | None = None) -> None:
        """Set all flows, or those of ``rows`` ``[B]``, to shifted populations ``[B, Q, Y, X]``."""
        size = self._stepper.layout.num_envs
        wanted = torch.ones(self.num_envs, dtype=torch.bool) if rows is None else rows
        for index, group in self._groups.items():
            mine = slice(index * size, (index + 1) * size)
            mask = wanted[mine].view(-1, 1, 1)
            for q, view in enumerate(self._stepper.layout.nodes(group.populations, 0, False)):
                stored = self.config.storage.encode(f[mine, q].to(self.device))
                view.copy_(torch.where(mask, stored, view))

    def command_(self, turn: Tensor, num_steps: int, frequency: Tensor | None = None) -> None:
        """Order the first body to turn and, optionally, to beat at a new frequency.

        Args:
            turn: ``[B]`` change of heading, radians, spread smoothly over ``num_steps``.
            num_steps: length of the turn.
            frequency: ``[B]`` tail beats per step; the phase stays continuous.
        """
        if num_steps < 2:
            raise ValueError(f"num_steps = {num_steps}: a turn takes at least two steps")
        body = self.body
        body.turn.copy_(turn)
        body.turn_steps.fill_(float(num_steps))
        body.turn_clock.zero_()
        if frequency is not None:
            body.frequency.copy_(frequency)

    def populations(self) -> Tensor:
        """Return a copy of the incoming populations ``[B, Q, Y, X]`` (shifted)."""
        return torch.cat([torch.stack(self._read(g), 1) for g in self._groups.values()])

    def _read(self, group: FlowGroup) -> list[Tensor]:
        """Return the nine incoming populations ``[B, Y, X]`` of a group."""
        return [self.config.storage.decode(f) for f in group.nodes]

    def macroscopic(self) -> tuple[Tensor, Tensor]:
        """Return density ``[B, Y, X]`` and velocity ``[B, 2, Y, X]``."""
        fields = [self._read_group(group) for group in self._groups.values()]
        return torch.cat([rho for rho, _ in fields]), torch.cat([u for _, u in fields])

    def _read_group(self, group: FlowGroup) -> tuple[Tensor, Tensor]:
        fluid = compute_macroscopic(self._read(group))
        return fluid.rho, torch.stack((fluid.ux, fluid.uy), 1)

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return density ``[B, P]`` and velocity ``[B, P, 2]`` at points ``[B, P, 2]`` (x, y)."""
        if points.dim() != 3 or (points.shape[0], points.shape[2]) != (self.num_envs, 2):
            raise ValueError(
                f"points have shape {tuple(points.shape)}: give ({self.num_envs}, P, 2), some for "
                "each flow"
            )
        layout = self._stepper.layout
        return sample_flow(self._data, layout, self.config.storage, points.to(self.device))

    def markers(self, index: int = 0) -> Tensor:
        """Return the closed outline ``[B, N, 2]`` of a body in nodes, nose first.

        Args:
            index: of the body.
        """
        return locate_markers(*self._get_body(index))

    def surface(self, index: int = 0) -> Markers:
        """Return the markers of a body with their arms and deformation velocities.

        Args:
            index: of the body.
        """
        config, params, state = self._get_body(index)
        return place_markers(state, deform_body(config, params, state))

    def _get_body(self, index: int) -> tuple[BodyConfig, BodyParams, BodyState]:
        if not 0 <= index < len(self.bodies):
            raise ValueError(
                f"body {index} of a flow with {len(self.bodies)}: give FlowConfig bodies, and an "
                "index below their number"
            )
        return self.config.bodies[index], self.flow.params.bodies[index], self.bodies[index]

    def head(self) -> Tensor:
        """Return the nose of the first body ``[B, 2]`` in nodes."""
        return self.markers()[:, 0]

    def is_diverged(self) -> Tensor:
        """Return ``[B]``: not finite, too fast for the method, or a body outside the grid."""
        fine = torch.cat([self._stepper.is_fine(group) for group in self._groups.values()])
        size = torch.tensor([self.config.width, self.config.height], device=self.device)
        for index in range(len(self.bodies)):
            markers = self.markers(index)
            fine = fine & ((markers > 0.5) & (markers < size - 1.5)).all(-1).all(-1)
        return ~fine

    def state_dict(self) -> dict[str, Tensor]:
        """Return everything that the future depends on, as copies."""
        return {name: own.clone() for name, own in self._named_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore ``state_dict()`` exactly."""
        for name, own in self._named_state():
            expected = f"{own.dtype} of shape {tuple(own.shape)}"
            saved = state.get(name)
            got = "nothing" if saved is None else f"{saved.dtype} of shape {tuple(saved.shape)}"
            if got != expected:
                raise ValueError(
                    f"state '{name}' is {got}, expected {expected}: it was saved by a solver of "
                    "another grid, batch, storage or version"
                )
        for name, own in self._named_state():
            own.copy_(state[name])

    def _named_state(self) -> list[tuple[str, Tensor]]:
        pairs, _ = pytree.tree_flatten_with_path(self.flow)
        named = [(pytree.keystr(path).lstrip("."), leaf) for path, leaf in pairs]
        # states saved so far call the bodies' parameters "shapes"
        named = [(n.replace("params.bodies", "params.shapes"), leaf) for n, leaf in named]
        return [("data", self._data), ("omega", self._omega), *named]
