"""A batch of flows in memory: what environments hold, reset, command, advance and read."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot
from typing import Annotated

import torch
from pydantic import Field, NonNegativeInt, PositiveInt
from torch import Tensor

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.collision import compute_equilibrium
from fishrl.physics.commands import Commands
from fishrl.physics.fast.checks import (
    check_device,
    check_populations,
    check_tensor,
    list_configs,
    read_frequency,
)
from fishrl.physics.fast.execution import Execution
from fishrl.physics.fast.flow_memory import set_rows_
from fishrl.physics.fast.part import Part
from fishrl.physics.fast.watch import Watch
from fishrl.physics.flow import FlowConfig, change_stream_speed, compute_stream_speed
from fishrl.physics.geometry import Markers, deform_body, locate_markers, place_markers
from fishrl.physics.lattice import MAX_IMPOSED_SPEED
from fishrl.physics.placement import check_placement, find_water, lies_inside, spread_starts
from fishrl.settings import checked
from fishrl.torch_state import with_own_state


@with_own_state
class InPlaceSolver:
    """A batch of flows and the bodies in them, advanced in place.

    Args:
        config: one for all flows, or one per flow; see ``FlowConfig`` for what may differ.
        num_envs: number of flows B; with one configuration per flow it may be left out.
        frequency: tail beats or oscillations per step at start, of all bodies; ``[B]`` or a number.
            None is 0, with a warning where a fish is then advanced that no command made beat.
        device: where everything lives.
        compile: compile the step; otherwise the same functions run eagerly.
        num_workers: CPU processes that share the flows, each on one core. None takes one per core,
            at most one per flow, where the step is compiled, and runs a single flow in this
            process, on one core; 0 runs all flows in this process, each on all of torch's threads,
            which is faster for a single large flow on an idle machine and much slower on a busy
            one; 0 on a GPU, and with classes of a notebook or script.
        flows_per_launch: flows per group, which each pass over memory advances together; a divisor
            of B. None is one on a CPU, whose cache holds a flow, and all on a GPU.
    """

    @checked
    def __init__(
        self,
        *,
        config: FlowConfig | Sequence[FlowConfig],
        num_envs: PositiveInt | None = None,
        frequency: float | Tensor | None = None,
        device: torch.device | str = "cpu",
        compile: bool = True,
        num_workers: NonNegativeInt | None = None,
        flows_per_launch: PositiveInt | None = None,
    ) -> None:
        check_device(device)
        device = torch.device(device)
        self.configs = configs = list_configs(config, num_envs, device)
        self.config, self.num_envs, self.device = configs[0], len(configs), device
        self._frequency = read_frequency(frequency, configs).to(device)
        self._execution = Execution(
            configs,
            device=device,
            compile=compile,
            num_workers=num_workers,
            flows_per_launch=flows_per_launch,
        )
        self._batch, self._group_size = self._execution.batch, self._execution.group_size
        # several bodies overlap in the middle until they are placed
        has_many = len(self.config.bodies) > 1
        self._unplaced = self._choose(None) if has_many else None
        self._watch = Watch(self.config, self.num_envs, device)
        self._commands = Commands(configs)
        self._watch.is_idle = frequency is None and self.config.fish is not None
        self._batch.initialise_()
        self._rise = self._batch.flow.params.ramp_steps.clone()
        for body in self.bodies:
            body.frequency.copy_(self._frequency)

    def __getstate__(self) -> object:
        """Refuse copies and pickles, which would share recorded calls and processes."""
        raise TypeError(
            "a solver, or an environment with it, cannot be copied or pickled: make another one, "
            "and load_state_dict(state_dict())"
        )

    @property
    def bodies(self) -> tuple[BodyState, ...]:
        """The bodies' states, in the order of the configuration; tensors change in place."""
        return self._batch.flow.bodies

    @property
    def body(self) -> BodyState:
        """The first body's state, the fish where there is one."""
        self._get_body(0)
        return self.bodies[0]

    def compile(self) -> None:
        """Compile the step and start the workers; the first ``advance_`` does it otherwise."""
        self._execution.compile()

    def close(self) -> None:
        """End the workers, if any; the flows can still be read."""
        self._execution.close()

    @checked
    def advance_(self, num_steps: NonNegativeInt, rows: Tensor | None = None) -> None:
        """Advance the flows of ``rows`` ``[B]`` bool (None is all) by an even number of steps.

        With levels it is a multiple of 2^levels: even on the coarsest one. Flows that share a group
        with one of them advance too; all others keep their state. On a CPU each flow is its own
        group by default. On a GPU all flows are one group, which always advances, since the host
        would have to wait to see whether any row must.

        On a CPU a warning is logged, once, for flows that are no longer finite, whose bodies or
        patches overlap, or a body of which has left grid or patch; not with ``rows``, whose caller,
        such as the environment, handles each flow.

        Raises:
            ValueError: for an odd number of steps, for ``rows`` that are not ``[B]`` bool, for
                several bodies that have not been placed, and as ``command_``.
        """
        unit = 2 * self.config.coarsest_spacing
        if num_steps % unit:
            raise ValueError(f"num_steps = {num_steps}: must be a multiple of {unit}, or 0")
        chosen, size = self._choose(rows), self._group_size
        is_one_launch = self.device.type == "cuda" and size == self.num_envs
        flags = [True] if is_one_launch else chosen.view(-1, size).any(-1).tolist()
        groups = [number for number, is_wanted in enumerate(flags) if is_wanted]
        if self._unplaced is not None and self._unplaced.view(-1, self._group_size)[groups].any():
            raise ValueError(
                f"the {len(self.bodies)} bodies overlap at the centre of the domain: "
                "call reset_(position=...) first"
            )
        self._commands.check(self.bodies, self._batch.flow.params.bodies)
        for index, num in enumerate(self._watch.split(num_steps, unit)):
            if index:
                self._watch.look_(self._outlines())
            self._execution.advance_(num, groups)
        if rows is None and self.device.type == "cpu":
            self._watch.report(self._outlines(), self._batch.is_lost(), self._batch.are_held())

    def _outlines(self) -> list[Tensor]:
        return [self.markers(index) for index in range(len(self.bodies))]

    def _choose(self, rows: Tensor | None) -> Tensor:
        """Return ``rows`` ``[B]`` on the device of the flows, all of them for None."""
        if rows is None:
            return torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        check_tensor("rows", rows, (self.num_envs,), dtype=torch.bool)
        return rows.to(self.device)

    @checked
    def reset_(
        self,
        rows: Tensor,
        position: Tensor | None = None,
        heading: Tensor | None = None,
        *,
        velocity: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Restart the flows in ``rows`` ``[B]`` bool: bodies in a uniform stream.

        Bodies are at rest, but see ``join_stream_``. Their commands, loads, totals and clock start
        from zero, and the stream has the speed last set, to which it rises from rest if
        ``ramp_steps`` says so; other parameters and flows stay.

        Args:
            rows: flows to restart.
            position: centre of mass in nodes, ``[B, 2]`` or for several bodies ``[B, M, 2]``, read
                where ``rows`` is true; None is the middle of the domain.
            heading: direction that the nose faces, radians, ``[B]`` or ``[B, M]``; None is 0.
            velocity: velocity of the fluid everywhere, in units of the stream speed.

        Raises:
            ValueError: for wrong shapes, speeds above 0.3, and bodies that overlap or reach beyond
                the grid; then nothing has changed.
        """
        rows = self._choose(rows)
        position, heading = spread_starts(
            position, heading, self.config, self.num_envs, self.device
        )
        check_tensor("position", position, where=rows)
        check_tensor("heading", heading, where=rows)
        flow = self._batch.flow
        fastest = hypot(*velocity) * flow.params.stream_speed
        check_tensor("velocity times stream_speed", fastest, where=rows, largest=MAX_IMPOSED_SPEED)
        frequency = torch.zeros_like(heading[:, 0]) + self._frequency
        each = zip(self.bodies, position.unbind(1), heading.unbind(1), strict=False)
        fresh = [make_body(place, angle, frequency) for _, place, angle in each]
        check_placement(self.config, flow.params.bodies, fresh, rows)
        self._batch.check_places(fresh, rows)
        if self._unplaced is not None:
            left = self._unplaced & ~rows
            self._unplaced = left if left.any() else None
        self._watch.forget_(rows)
        zero = torch.zeros_like(flow.clock)
        params = flow.params._replace(ramp_steps=self._rise, former_speed=zero, ramp_start=zero)
        new = flow._replace(clock=zero, params=params, bodies=tuple(fresh))
        set_rows_(flow, new, rows, name="flow")
        speed = params.stream_speed.float()
        f = compute_equilibrium(0.0 * speed, velocity[0] * speed, velocity[1] * speed)
        self._batch.fill_(rows, f)
        self.join_stream_(rows)

    def join_stream_(self, rows: Tensor) -> None:
        """Give bodies that the flow moves, in ``rows`` ``[B]``, the mean velocity of their water.

        It is the water at their markers. Nothing changes with an ``ImmersedBoundary``, where a body
        as light as water follows it from the first step, whatever its velocity.
        """
        if self.config.skin.has_water_inside:
            return
        for index, (body, state) in enumerate(zip(self.config.bodies, self.bodies, strict=True)):
            water = self.sample(self.markers(index))[1].mean(1)
            for axis in {0, 1} & set(body.motion.free_axes):
                own = state.velocity[:, axis]
                own.copy_(torch.where(rows, water[:, axis], own))

    @property
    def stream_speed(self) -> Tensor:
        """Present stream speed of each flow ``[B]``, nodes per step; a copy."""
        return compute_stream_speed(self._batch.flow.params, self._batch.flow.clock)

    @checked
    def set_stream_speed_(
        self, speed: Tensor, rows: Tensor | None = None, *, num_steps: PositiveInt | None = None
    ) -> None:
        """Set the stream speed ``[B]`` of all flows, or of those in ``rows`` ``[B]``.

        Args:
            speed: nodes per step; ValueError on a CPU where ``FlowConfig`` does not allow it.
            rows: which flows.
            num_steps: over which the speed changes smoothly, from what it is now; by default it is
                set immediately, and a rise from rest continues.
        """
        rows = self._choose(rows)
        check_tensor("speed", speed, (self.num_envs,), where=rows)
        if rows.device.type == "cpu" and rows.any():
            replace(self.config, stream_speed=float(speed[rows].abs().max()))
        flow = self._batch.flow
        new = change_stream_speed(flow.params, flow.clock, speed.to(flow.clock), num_steps)
        set_rows_(flow.params[:-1], new[:-1], rows, name="speed")

    def set_body_(self, index: int, params: BodyParams, rows: Tensor | None = None) -> None:
        """Give a body of all flows, or of those in ``rows`` ``[B]``, other parameters ``[B, ...]``.

        Place it again with ``reset_``. ValueError for another kind of body or number of markers.
        """
        set_rows_(self._get_body(index)[1], params, self._choose(rows), name="params")
        self._commands.forget(index)

    def set_populations_(
        self, f: Tensor | Sequence[Tensor | None], rows: Tensor | None = None
    ) -> None:
        """Set all flows, or the N of ``rows`` ``[B]``, to shifted populations ``[N, Q, Y, X]``.

        On a GPU ``f`` may be of all B flows. With levels give those of each grid where it is, of N,
        coarsest first, or None for what its parent fills.
        """
        own = self._batch.choose_written(self._choose(rows), f)
        self._batch.write_(own, check_populations(f, self.config, len(own)))

    @checked
    def command_(
        self,
        turn: Tensor,
        num_steps: Annotated[int, Field(ge=2)],
        frequency: Tensor | None = None,
        amplitude: Tensor | None = None,
    ) -> None:
        """Command the first bodies to turn and, optionally, to beat differently.

        Args:
            turn: change of heading in radians, spread smoothly over ``num_steps``: ``[B]`` of the
                first body, or ``[B, M]`` of the first M; other bodies keep their commands.
            num_steps: at least two.
            frequency: tail beats per step, of the shape of ``turn``; the phase stays continuous.
            amplitude: share of the gait's, of the shape of ``turn``; approached smoothly.

        Raises:
            ValueError: for another shape, numbers that are not finite, more than all bodies, and on
                a CPU for a surface that would exceed 0.3 nodes per step, or an amplitude above 1.
        """
        check_tensor("turn", turn)
        every, shape = self._choose(None), (self.num_envs, *turn.shape[1:2])
        columns: dict[str, tuple[Tensor, ...]] = {}
        given = {"turn": turn, "frequency": frequency, "amplitude_goal": amplitude}
        for name, value in given.items():
            if value is not None:
                check_tensor(name.removesuffix("_goal"), value, shape, where=every)
                columns[name] = value.reshape(self.num_envs, -1).to(self._frequency).unbind(1)
        self._get_body(len(columns["turn"]) - 1)
        zero = torch.zeros_like(columns["turn"][0])
        orders = [
            dict(zip(columns, own, strict=True), turn_steps=zero + num_steps, turn_clock=zero)
            for own in zip(*columns.values(), strict=True)
        ]
        pairs = list(zip(self.bodies, orders, strict=False))
        new = [body._replace(**order) for body, order in pairs]
        self._commands.check(new, self._batch.flow.params.bodies)
        self._watch.is_idle &= frequency is None
        for body, order in pairs:
            for name, value in order.items():
                getattr(body, name).copy_(value)

    def populations(self, grid: int = 0) -> Tensor:
        """Return a copy of the incoming populations ``[B, Q, Y, X]`` (shifted) of a grid.

        Grids are numbered as in ``config.list_grids()``, coarsest first.
        """
        num = len(self._batch.grids)
        if not 0 <= grid < num:
            raise ValueError(f"there is no grid {grid}: the flow has {num}, counted from 0")
        return self._batch.grids[grid].populations()

    @property
    def corners(self) -> Tensor:
        """``[B, G, 2]`` int64: first node (x, y) of each grid, in finest nodes; a copy."""
        return torch.stack(self._batch.find_corners(), 1)

    def macroscopic(self, rows: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return density ``[N, Y, X]`` and velocity ``[N, 2, Y, X]`` of all flows or ``rows``."""
        return self._batch.macroscopic(None if rows is None else self._choose(rows))

    def vorticity(self, rows: Tensor | None = None, *, is_water: Tensor | None = None) -> Tensor:
        """Return ``compute_vorticity`` ``[N, Y, X]``, of each level by its own nodes."""
        return self._batch.vorticity(None if rows is None else self._choose(rows), is_water)

    def find_water(self) -> Tensor:
        """Return ``[B, Y, X]`` bool: nodes of the flow, all but those inside a sharp skin."""
        return find_water(self._outlines(), self.config, self._choose(None))

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return density ``[B, P]`` and velocity ``[B, P, 2]`` at points ``[B, P, 2]`` (x, y).

        Both are NaN where a point is.
        """
        check_tensor("points", points, (self.num_envs, None, 2))
        return self._batch.sample(points.to(self.device))

    def markers(self, index: int = 0) -> Tensor:
        """Return the closed outline ``[B, N, 2]`` of a body in nodes, nose first."""
        return locate_markers(*self._get_body(index)[1:])

    def surface(self, index: int = 0) -> Markers:
        """Return the markers of a body with their arms and deformation velocities."""
        config, params, state = self._get_body(index)
        return place_markers(state, deform_body(config, params, state))

    def _get_body(self, index: int) -> tuple[BodyConfig, BodyParams, BodyState]:
        if not 0 <= index < len(self.bodies):
            raise ValueError(
                f"there is no body {index}: the flow has {len(self.bodies)}, counted from 0; see "
                "FlowConfig(bodies=...)"
            )
        return self.config.bodies[index], self._batch.flow.params.bodies[index], self.bodies[index]

    @property
    def overlaps(self) -> Tensor:
        """``[B]`` bool: whether bodies have grown into each other since reset; a copy."""
        self._watch.look_(self._outlines())
        return self._watch.overlaps.clone()

    def is_diverged(self) -> Tensor:
        """Return ``[B]`` bool: density or speed out of range, a body off the grid, or overlap."""
        fine, outlines = self._batch.is_fine(), self._outlines()
        for outline in outlines:
            fine = fine & lies_inside(outline, self.config)
        self._watch.look_(outlines)
        return ~fine | self._watch.overlaps

    def state_dict(self) -> dict[str, Tensor]:
        """Return the complete state as copies, every tensor ``[B, ...]``."""
        return {name: torch.cat(own) for name, own in self._batch.name_state().items()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Restore ``state_dict()`` exactly; ValueError for another grid, batch or version."""
        self._batch.load_state_(state)
        self._unplaced = None
        self._commands.forget(*range(len(self.bodies)))
        self._watch.forget_(self._choose(None))

    def list_calls(self) -> list[tuple[Part, tuple[Sequence[Tensor], Sequence[Tensor]]]]:
        """Return the parts of a step in order, the collision first with one level, to measure them.

        Each comes with the first group's arguments of ``run`` at even and at odd steps.
        """
        return self._batch.list_calls()
