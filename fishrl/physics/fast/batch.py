"""All flows of a batch, and the steps that advance them in this process."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import combinations

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.fast.fields import lay_together, read_fluid, read_vorticity
from fishrl.physics.fast.grid import Allocate, Grid, make_fresh
from fishrl.physics.fast.part import Bound, Part, Repeater, Step, compile_parts, copy_tree
from fishrl.physics.fast.transfer_parts import (
    Occasionally,
    PatchMemory,
    make_filling,
    make_moving,
    make_restriction,
    make_shift_choice,
)
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import locate_markers
from fishrl.physics.levels.grids import find_corners, list_chains, place_patches, plan_levels
from fishrl.physics.levels.patch import RING
from fishrl.physics.levels.transfer import fill_all
from fishrl.torch_state import one_thread

Pairs = list[tuple[Tensor, Tensor]]
Arguments = tuple[Sequence[Tensor], Sequence[Tensor]]  # before even and odd steps of the parent
Calls = list[tuple[Part, Arguments]]


class FlowBatch:
    """Flows in memory, in groups that advance together.

    Between advances ``flow`` has all numbers, in nodes and steps of the finest level. With levels
    an advance hands them to the grids, bodies with positions in their patches, and takes them back.

    Args:
        configs: one per flow.
        group_size: flows per group.
        device: where everything lives.
        allocate: makes blocks of memory, from their size in bytes.

    Attributes:
        flow: everything except the populations, changed in place.
        grids: as in ``FlowConfig.list_grids``.
    """

    def __init__(
        self,
        configs: Sequence[FlowConfig],
        *,
        group_size: int,
        device: torch.device,
        allocate: Allocate,
    ) -> None:
        self._config, self._fresh = configs[0], make_fresh(configs, device)
        plans = zip(*map(plan_levels, configs), strict=True)
        self.grids = [
            Grid(own, group_size=group_size, device=device, allocate=allocate) for own in plans
        ]
        self._root, *self._patches = self.grids
        self._levels = [grid.level for grid in self.grids]
        self.flow = self._root.flow
        if self._patches:
            self.flow = pytree.tree_map(
                lambda t: t.clone(memory_format=torch.contiguous_format), self._fresh
            )
        sizes = [grid.level.frame.size for grid in self._patches]
        self._fills = [make_filling(*size) for size in sizes]
        self._takes, self._ends = (
            [make_restriction(is_whole=is_whole) for _ in sizes] for is_whole in (False, True)
        )
        self._numbers = range(len(self._root.arguments))
        self._transfers: dict[tuple[Part, int], Arguments] = {
            (part, number): part.bind(self._find_memory(grid, number))
            for parts in (self._fills, self._takes, self._ends)
            for part, grid in zip(parts, self._patches, strict=True)
            for number in self._numbers
        }
        self._chains = list_chains(self._levels)
        self._moving = [chain for chain in self._chains if self._levels[chain[0]].moves]
        self._choices = [make_shift_choice([self._levels[n] for n in own]) for own in self._moving]
        self._moves = [make_moving(device) for _ in self._moving]
        self._repeaters = [self._make_repeaters(number) for number in self._numbers]
        self._params, self._states = self._pair_bodies()

    def _find_memory(self, grid: Grid, number: int) -> PatchMemory:
        parent, own = self.grids[grid.level.parent], grid.rows_of(number)
        return PatchMemory(grid.memory_of(number), parent.memory_of(number), grid.origin[own])

    def _make_repeaters(self, number: int) -> tuple[Repeater, Repeater, Repeater]:
        """Return a group's steps: once before many, a pair of the coarsest level, once after."""
        ends = [*reversed(self._ends), *self._fills]  # all nodes valid, to be read or stored
        return (
            Repeater(self._list_located(number)),
            Repeater(self._list_pair(number)),
            Repeater([(part, self._transfers[part, number][0]) for part in ends]),
        )

    def _list_located(self, number: int) -> list[Bound]:
        """Return what finds out where still bodies and sharp skins are."""
        return [bound for grid in self.grids for bound in grid.list_located(number)]

    def _list_pair(self, number: int) -> list[tuple[Step, Sequence[Tensor]]]:
        """Return what an even and an odd step of the coarsest level consist of."""
        by, choices, moves = self._bind_moves(number)
        steps: list[tuple[Step, Sequence[Tensor]]] = []
        for parity in (0, 1):
            steps += [(part, arguments[parity]) for part, arguments in choices]
            fills = [
                (part, self._transfers[part, number][0 if grid.level.parent else parity])
                for part, grid in zip(self._fills, self._patches, strict=True)
            ]  # what lies in the ring moves inwards
            moved = [(part, arguments[parity]) for part, arguments in moves]
            shift = [*fills, *moved, *self._list_located(number)] if moves else []
            if shift and by.device.type == "cpu":
                steps.append((Occasionally(by, Repeater(shift)), ()))
            else:
                steps += shift
            steps += self._list_step(0, number, parity)
        return steps

    def _bind_moves(self, number: int) -> tuple[Tensor, Calls, Calls]:
        """Return a group's moves, what chooses them for patches that follow bodies, and moves."""
        by = torch.zeros_like(self._root.origin[self._root.rows_of(number)])
        by = by.repeat(len(self.grids), 1, 1)
        chains = [
            ([self._find_memory(self.grids[n], number) for n in own], by[own[0] : own[-1] + 1])
            for own in self._moving
        ]
        choices, moves = (
            [(part, part.bind(chain)) for part, chain in zip(parts, chains, strict=True)]
            for parts in (self._choices, self._moves)
        )
        return by, choices, moves

    def _list_step(self, grid: int, number: int, parity: int) -> list[Bound]:
        """Return a group's parts of a step of a grid, and of two of those inside it."""
        inside = [n for n, own in enumerate(self._levels) if n and own.parent == grid]
        fills, takes = ([parts[n - 1] for n in inside] for parts in (self._fills, self._takes))
        steps = [(part, self._transfers[part, number][parity]) for part in fills]
        steps += self.grids[grid].list_step(number, parity)
        for finer in inside:
            for half in (0, 1):
                steps += self._list_step(finer, number, half)
        return steps + [(part, self._transfers[part, number][1 - parity]) for part in takes]

    def _list_all(self, *, with_check: bool) -> list[Bound]:
        """Return all parts with arguments of the first group."""
        parts = [own for grid in reversed(self.grids) for own in grid.list_all(with_check)]
        transfers = [(part, args) for (part, number), args in self._transfers.items() if not number]
        _, choices, moves = self._bind_moves(0)
        return parts + [(part, args[0]) for part, args in (*transfers, *choices, *moves)]

    def compile(self, *, with_check: bool, helps: bool = False) -> None:
        """Compile all parts, as ``compile_parts``; a process that reads flows needs the check."""
        compile_parts(self._list_all(with_check=with_check), helps=helps)
        self._forget_checks()

    def compile_check(self) -> None:
        """Compile the checks alone, for a process that reads flows which others advance."""
        for grid in self.grids:
            grid.check.compile(grid.arguments[0][grid.check][0])
        self._forget_checks()

    def _forget_checks(self) -> None:
        for grid in self.grids:
            grid.forget_checks()

    def is_new(self) -> bool:
        """Return whether ``compile`` would put new code on the disk."""
        return not all(part.is_stored(own) for part, own in self._list_all(with_check=True))

    def list_calls(self) -> Calls:
        """Return ``InPlaceSolver.list_calls``, of a step of the coarsest level."""
        even, odd = (self._list_step(0, 0, parity) for parity in (0, 1))
        own = [(part, (at, after)) for (part, at), (_, after) in zip(even, odd, strict=True)]
        return [*self._bind_moves(0)[1], *own]

    def advance_(self, num_steps: int, wanted: Collection[int]) -> None:
        """Advance the wanted groups."""
        num_pairs = num_steps // self._root.level.spacing // 2
        for number in self._numbers:
            if number in wanted and num_pairs:
                begin, pair, end = self._repeaters[number]
                begin.run(1)
                pair.run(num_pairs)
                end.run(1)

    def _pair_bodies(self) -> tuple[Pairs, Pairs]:
        """Return parameters and states of the bodies: tensors of their grids, and of all."""
        params: Pairs = []
        states: Pairs = []
        for grid in self._patches:
            for place, number in enumerate(grid.level.bodies):
                both = grid.flow.params.bodies[place], self.flow.params.bodies[number]
                params += zip(*map(pytree.tree_leaves, both), strict=True)
                states += zip(grid.flow.bodies[place], self.flow.bodies[number], strict=True)
        return params, states

    def before_(self) -> None:
        """Prepare an advance: hand numbers and bodies to the grids of several levels."""
        if not self._patches:
            return
        _copy([*self._params, *self._states])
        for grid, corner in zip(self.grids, self.find_corners(), strict=True):
            own, params = grid.flow, grid.level.convert(self.flow.params)
            _copy(zip(own.params[:-1], params[:-1], strict=True))
            own.clock.copy_(self.flow.clock / grid.level.spacing)
            for body in own.bodies:
                body.position.sub_(corner)

    def after_(self, wanted: Collection[int]) -> None:
        """End it: take the numbers of some groups back."""
        if not self._patches:
            return
        for grid, corner in zip(self.grids, self.find_corners(), strict=True):
            for body in grid.flow.bodies:
                body.position.add_(corner)
        clock = self._root.flow.clock * self._root.level.spacing
        pairs = [(self.flow.clock, clock), *((given, own) for own, given in self._states)]
        rows = [self._root.rows_of(number) for number in wanted]
        if len(rows) < len(self._numbers):
            pairs = [(to[own], new[own]) for own in rows for to, new in pairs]
        _copy(pairs)

    def initialise_(self) -> None:
        """Write the initial parameters, bodies at rest and relaxation rates; place patches."""
        copy_tree(self.flow, self._fresh)
        self.before_()
        for grid in self.grids:
            grid.set_omega_()
        self._place_(torch.ones_like(self.flow.clock, dtype=torch.bool))

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set all nodes of the flows in ``rows`` ``[B]`` to populations ``[B]``; place patches."""
        for grid in self.grids:
            grid.fill_(rows, f)
        self._place_(rows)

    def _place_(self, rows: Tensor) -> None:
        """Put the patches of some flows around their bodies."""
        origins = place_patches(self._levels, self.flow.bodies, self.flow.clock)
        for grid, origin in zip(self._patches, origins[1:], strict=True):
            grid.origin.copy_(torch.where(rows[:, None], origin, grid.origin))

    def find_corners(self) -> list[Tensor]:
        """Return the place ``[B, 2]`` int64 of the first node of each grid, finest nodes."""
        return find_corners(self._levels, [grid.origin for grid in self.grids])

    def check_places(self, bodies: Sequence[BodyState], rows: Tensor) -> None:
        """Raise ValueError for bodies in ``rows`` ``[B]`` that patches cannot hold."""
        if not self._patches or (rows.is_cuda and torch.cuda.is_current_stream_capturing()):
            return
        origins = place_patches(self._levels, bodies, self.flow.clock)
        for is_wrong, problem in (
            (self._find_overlap(origins), "patches of {} nodes overlap; move the bodies apart"),
            (~self._find_inside(origins, bodies), "a body is not within its patch of {} nodes"),
        ):
            if (is_wrong & rows).any():
                unit, top = self._root.level.spacing, [chain[0] for chain in self._chains]
                sizes = [tuple(unit * (n // 2) for n in self._levels[p].frame.size) for p in top]
                raise ValueError(
                    f"flow {int((is_wrong & rows).int().argmax())}: {problem.format(sizes)}, take "
                    "fewer levels, or give FlowConfig(patches=...) that hold the bodies"
                )

    def _find_overlap(self, origins: Sequence[Tensor]) -> Tensor:
        """Return ``[B]``: whether patches of the root share more than their outermost nodes."""
        found = torch.zeros_like(self.flow.clock, dtype=torch.bool)
        for one, other in combinations([chain[0] for chain in self._chains], 2):
            gap = origins[one] - origins[other]
            ahead, behind = (0.5 * self.grids[n].last for n in (other, one))
            found |= ((gap < ahead) & (gap > -behind)).all(-1)
        return found

    def _find_inside(self, origins: Sequence[Tensor], bodies: Sequence[BodyState]) -> Tensor:
        """Return ``[B]``: whether all bodies lie where their patches are valid."""
        found = torch.ones_like(self.flow.clock, dtype=torch.bool)
        reach, corners = RING + self._config.skin.margin, find_corners(self._levels, origins)
        for grid, corner in zip(self._patches, corners[1:], strict=True):
            low = corner[:, None] + reach
            high = low + grid.last - 2 * reach
            for index in grid.level.bodies:
                outline = locate_markers(self.flow.params.bodies[index], bodies[index])
                found &= ((outline > low) & (outline < high)).flatten(1).all(-1)
        return found

    def is_fine(self) -> Tensor:
        """Return ``[B]``: density and speed are within the method, and bodies in their patches."""
        fine = self.are_held()
        with one_thread():  # several would wait for each other, on a busy machine for seconds
            return fine & torch.stack([grid.is_fine() for grid in self.grids]).all(0)

    def are_held(self) -> Tensor:
        """Return ``[B]``: patches hold their bodies, and do not overlap."""
        origins = [grid.origin for grid in self.grids]
        return self._find_inside(origins, self.flow.bodies) & ~self._find_overlap(origins)

    def is_lost(self) -> Tensor:
        """Return ``[B]``: the middle of a grid is not finite."""
        return torch.stack([grid.is_lost() for grid in self.grids]).any(0)

    def choose_written(self, rows: Tensor, f: Tensor | Sequence[Tensor | None]) -> Tensor:
        """Return the rows for ``write_``: ``[B]`` bool on a GPU, if ``f`` is of all flows."""
        first = f if isinstance(f, Tensor) else f[0]
        is_whole = first is not None and len(first) == len(rows) and not self._patches
        return rows if rows.is_cuda and is_whole else rows.nonzero()[:, 0]

    def write_(self, rows: Tensor, f: Sequence[Tensor | None]) -> None:
        """Set populations of each grid; see ``InPlaceSolver.set_populations_``.

        ``rows`` ``[N]`` are indices, or ``[B]`` bool, and then ``f`` is of all flows.
        """
        for grid, own in zip(self.grids, f, strict=True):
            if own is None:
                parent = self.grids[grid.level.parent].populations()[rows]
                tau = grid.level.convert(self.flow.params).tau[rows]
                own = fill_all(grid.level.frame.size, parent, grid.origin[rows], tau)
            grid.write_(rows, own)

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Read density and velocity at points, see ``Grid.sample``, on the finest grid there."""
        rho, u = self._root.sample(points / self._root.level.spacing)
        for grid, corner in zip(self._patches, self.find_corners()[1:], strict=True):
            own = (points - corner[:, None]) / grid.level.spacing
            inside = ((own >= RING) & (own <= grid.last - RING)).all(-1)
            values = grid.sample(own)
            rho = torch.where(inside, values[0], rho)
            u = torch.where(inside[..., None], values[1], u)
        return rho, u

    def macroscopic(self, rows: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return density ``[N, Y, X]`` and velocity ``[N, 2, Y, X]`` of flows ``rows`` ``[B]``.

        Between the nodes of coarser levels they are linear.
        """
        field = self._lay_together(rows, lambda grid, _: read_fluid(grid, rows))
        return field[:, 0], field[:, 1:]

    def vorticity(self, rows: Tensor | None = None, is_water: Tensor | None = None) -> Tensor:
        """Return vorticity ``[N, Y, X]`` of flows ``rows`` ``[B]``; see ``compute_vorticity``.

        Differences are those of each grid's own nodes.
        """
        water = is_water if is_water is None or rows is None else is_water[rows]
        return self._lay_together(
            rows, lambda grid, corner: read_vorticity(grid, corner, rows, water)
        )[:, 0]

    def _lay_together(self, rows: Tensor | None, read: Callable[[Grid, Tensor], Tensor]) -> Tensor:
        corners = [own if rows is None else own[rows] for own in self.find_corners()]
        return lay_together(self.grids, corners, self._config, read)

    def name_state(self) -> dict[str, list[Tensor]]:
        """Return everything that the future depends on, by name, each in groups of flows."""
        named: dict[str, list[Tensor]] = {}
        for number, grid in enumerate(self.grids):
            own = grid.name_state() | ({"origin": [grid.origin]} if number else {})
            named |= {f"patch {number} {name}" if number else name: v for name, v in own.items()}
        pairs, _ = pytree.tree_flatten_with_path(self.flow)
        return named | {pytree.keystr(path).lstrip("."): [leaf] for path, leaf in pairs}

    def load_state_(self, state: Mapping[str, Tensor]) -> None:
        """Restore the tensors of ``name_state``, each of all flows ``[B, ...]``.

        Raises:
            ValueError: for a state of another grid, batch or version.
        """
        own = self.name_state()
        for name, parts in own.items():
            shape = (sum(map(len, parts)), *parts[0].shape[1:])
            expected = f"{parts[0].dtype} of shape {shape}"
            saved = state.get(name)
            got = "nothing" if saved is None else f"{saved.dtype} of shape {tuple(saved.shape)}"
            if got != expected:
                raise ValueError(
                    f"state '{name}' is {got}, expected {expected}: it was saved by a solver of "
                    "another grid, batch or version"
                )
        for name, parts in own.items():
            for part, saved in zip(parts, torch.split(state[name], len(parts[0])), strict=True):
                part.copy_(saved)


def _copy(pairs: Iterable[tuple[Tensor, Tensor]]) -> None:
    """Copy the second tensor of each pair to the first."""
    for to, new in pairs:
        to.copy_(new)
