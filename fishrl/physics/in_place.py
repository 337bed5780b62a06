"""A batch of flows in memory: what environments hold, reset, command, advance and read."""

import logging
import os
import time
from collections.abc import Collection
from typing import Any

import torch
from torch import Tensor

from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.compiled import find_compiler_problem
from fishrl.physics.kinematics import deform
from fishrl.physics.rigid_motion import Body, make_body, place_markers
from fishrl.physics.state import FlowConfig
from fishrl.physics.stepper import FlowGroup, Stepper
from fishrl.physics.workers import SharedMemory, Workers, map_shared

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
        num_workers: CPU processes that share the flows, each on one core. None takes one per core,
            at most one per flow, where the step is compiled; 0 runs all flows here, each on all of
            torch's threads, which is faster for a single large flow on a quiet machine and much
            slower on a busy one. On a GPU it must be 0.
    """

    def __init__(
        self,
        *,
        config: FlowConfig,
        num_envs: int,
        frequency: float = 0.0,
        device: torch.device | str = "cpu",
        compile: bool = True,
        num_workers: int | None = None,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs}: at least one flow is needed")
        if config.boundaries.is_periodic:
            raise ValueError(
                "the in-place step has no periodic edges: use fishrl.physics.solver.step for them"
            )
        self.config, self.num_envs, self.device = config, num_envs, torch.device(device)
        is_cpu = self.device.type == "cpu"
        torch.set_flush_denormal(True)  # still water decays into denormals, which are slow
        if num_workers is None:
            can_share = is_cpu and compile and not find_compiler_problem("cpu")
            num_workers = min(os.cpu_count() or 1, num_envs) if can_share else 0
        if num_workers < 0 or (num_workers and not is_cpu):
            raise ValueError(
                f"num_workers = {num_workers} on {self.device}: allowed is 0 on a GPU, 0 or more "
                "on a CPU"
            )
        self._num_workers = min(num_workers, num_envs)
        self._workers: Workers | None = None
        self._frequency = frequency
        # one flow at a time fits a core's cache; a GPU wants them all in one launch
        self._stepper = Stepper(
            config=config, group_size=1 if is_cpu else num_envs, device=self.device
        )
        self._shared = SharedMemory(self._count_bytes()) if self._num_workers else None
        if self._shared is None:
            memory = torch.zeros(self._count_bytes(), dtype=torch.uint8, device=self.device)
        else:
            memory = self._shared.tensor
        self._bind(memory, range(num_envs // self._stepper.layout.num_envs))
        rest = torch.zeros(num_envs, dtype=torch.float64, device=self.device)
        centre = torch.tensor([0.5 * config.width, 0.5 * config.height], dtype=torch.float64)
        fresh = make_body(centre.to(self.device).expand(num_envs, 2), rest, rest + frequency)
        for own, new in zip(self.body, fresh, strict=True):
            own.copy_(new)
        self._wants_compile, self._is_closed = compile, False

    @classmethod
    def attach(
        cls, *, config: FlowConfig, num_envs: int, path: str, groups: range, compile: bool
    ) -> "InPlaceSolver":
        """Return a worker's solver, which advances ``groups`` of a batch in shared memory."""
        self = cls.__new__(cls)
        self.config, self.num_envs, self.device = config, num_envs, torch.device("cpu")
        self._workers, self._num_workers, self._wants_compile = None, 0, compile
        self._stepper = Stepper(config=config, group_size=1, device=self.device)
        self._bind(map_shared(path, self._count_bytes()), groups)
        self.compile()
        return self

    def _count_bytes(self) -> int:
        layout = self._stepper.layout
        populations = 4 * self.num_envs // layout.num_envs * layout.num_slots
        return populations + 8 * self.num_envs * _count_body_numbers()

    def _bind(self, memory: Tensor, groups: range) -> None:
        """Lay populations and bodies out in ``memory`` and make the views of some groups."""
        layout, size = self._stepper.layout, self._stepper.layout.num_envs
        numbers = 8 * self.num_envs * _count_body_numbers()
        self._data = memory[numbers:].view(torch.float32).view(-1, layout.num_slots)
        doubles = memory[:numbers].view(torch.float64)
        fields, at = [], 0
        for width in _BODY_WIDTHS:
            block = doubles[at : at + width * self.num_envs]
            fields.append(block.view(self.num_envs, width) if width > 1 else block)
            at += width * self.num_envs
        self.body = Body(*fields)
        self._groups = {
            g: FlowGroup(
                self._stepper,
                self._data[g],
                Body(*(t[g * size : (g + 1) * size] for t in self.body)),
            )
            for g in groups
        }

    def compile(self) -> None:
        """Compile the step and start the workers; the first ``advance_`` does it otherwise."""
        if self._num_workers and self._workers is None:
            assert self._shared is not None
            start = time.perf_counter()
            logger.info(
                "compiling the flow step for %d processes (up to a minute when new) ...",
                self._num_workers,
            )
            num_groups = len(self._groups)
            job = {
                "config": self.config,
                "num_envs": self.num_envs,
                "path": str(self._shared.path),
                "compile": self._wants_compile,
                "log_level": logging.WARNING,
            }
            shares = [range(w, num_groups, self._num_workers) for w in range(self._num_workers)]
            self._workers = Workers([job | {"groups": share} for share in shares])
            self._shared.unlink()
            logger.info("flow step ready after %.1f s", time.perf_counter() - start)
        elif not self._num_workers and self._wants_compile:
            start = time.perf_counter()
            logger.info("compiling the flow step (up to a minute when new) ...")
            self._stepper.compile(next(iter(self._groups.values())))
            self._wants_compile = False
            logger.info("flow step ready after %.1f s", time.perf_counter() - start)

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
                for _ in range(num_steps // 2):
                    self._stepper.step_(group, 0)
                    self._stepper.step_(group, 1)

    def reset_(self, rows: Tensor, position: Tensor, heading: Tensor) -> None:
        """Put the fish of some flows at rest into still water; other rows are not touched.

        Args:
            rows: ``[B]`` bool, which flows.
            position: ``[B, 2]`` centre of mass in nodes, read where ``rows`` is true.
            heading: ``[B]`` direction that the fish faces, radians, read likewise.
        """
        if rows.shape != (self.num_envs,) or rows.dtype != torch.bool:
            raise ValueError(
                f"rows has shape {tuple(rows.shape)} and type {rows.dtype}: give a bool tensor of "
                f"shape ({self.num_envs},)"
            )
        position, heading = position.double(), heading.double()
        fresh = make_body(position, heading, torch.full_like(heading, self._frequency))
        for old, new in zip(self.body, fresh, strict=True):
            old.copy_(torch.where(rows.view(-1, *(1,) * (old.dim() - 1)), new, old))
        size = self._stepper.layout.num_envs
        for group, mask in zip(self._groups.values(), torch.split(rows, size), strict=True):
            if size > 1 or mask.item():
                for f in group.cells[0]:
                    f.masked_fill_(mask[:, None], 0.0)

    def set_populations_(self, f: Tensor) -> None:
        """Set all flows to populations ``[B, Q, Y, X]`` (shifted)."""
        size = self._stepper.layout.num_envs
        for group, values in zip(self._groups.values(), torch.split(f, size), strict=True):
            for q, view in enumerate(self._stepper.layout.nodes(group.data, 0, False)):
                view.copy_(values[:, q])

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
        layout = self._stepper.layout
        return torch.cat(
            [torch.stack(layout.nodes(g.data, 0, False), 1) for g in self._groups.values()]
        )

    def macroscopic(self) -> tuple[Tensor, Tensor]:
        """Return density ``[B, Y, X]`` and velocity ``[B, 2, Y, X]``."""
        fields = [self._read_group(group) for group in self._groups.values()]
        return torch.cat([rho for rho, _ in fields]), torch.cat([u for _, u in fields])

    def _read_group(self, group: FlowGroup) -> tuple[Tensor, Tensor]:
        rho, jx, jy = compute_macroscopic(self._stepper.layout.nodes(group.data, 0, False))
        density = rho + 1.0
        return density, torch.stack((jx / density, jy / density), 1)

    def markers(self) -> Tensor:
        """Return the closed outline ``[B, N, 2]`` in nodes, nose first."""
        body, modes = self.body, self._stepper.modes
        if modes is None:
            raise ValueError("this flow has no fish: give FlowConfig a fish")
        shape = deform(modes, body.phase, body.frequency, body.age)
        return place_markers(body, modes, shape).position

    def head(self) -> Tensor:
        """Return the nose ``[B, 2]`` in nodes."""
        return self.markers()[:, 0]

    def is_diverged(self) -> Tensor:
        """Return ``[B]``: not finite, too fast for the method, or the fish outside the grid."""
        # comparisons with NaN are false, so a broken flow is never "fine"
        speeds = [(self._read_group(g)[1] ** 2).sum(1).flatten(1) for g in self._groups.values()]
        fine = torch.cat([(s < MAX_SPEED**2).all(-1) for s in speeds])
        if self._stepper.modes is not None:
            markers = self.markers()
            size = torch.tensor([self.config.width, self.config.height], device=self.device)
            fine = fine & ((markers > 0.5) & (markers < size - 1.5)).all(-1).all(-1)
        return ~fine

    def state_dict(self) -> dict[str, Tensor]:
        """Return everything that the future depends on, as copies."""
        return {name: own.clone() for name, own in self._named_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore ``state_dict()`` exactly."""
        for name, own in self._named_state():
            if name not in state or state[name].shape != own.shape:
                got = tuple(state[name].shape) if name in state else "nothing"
                raise ValueError(
                    f"state '{name}' has shape {got}, expected {tuple(own.shape)}: it was saved by "
                    "a solver of another grid, batch or version"
                )
            own.copy_(state[name])

    def _named_state(self) -> list[tuple[str, Tensor]]:
        return [("data", self._data), *zip(Body._fields, self.body, strict=True)]


_BODY_WIDTHS = [2 if name in ("position", "velocity", "force") else 1 for name in Body._fields]


def _count_body_numbers() -> int:
    return sum(_BODY_WIDTHS)
