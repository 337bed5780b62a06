"""A batch of flows with levels: one ``FlowBatch`` for each grid, and the parts between them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from itertools import combinations

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.fast.batch import FlowBatch, make_fresh, name_numbers, restore_
from fishrl.physics.fast.grid import (
    Grid,
    find_moving,
    lay_together,
    read_fluid,
    read_vorticity,
)
from fishrl.physics.fast.part import Bound, Part, Repeater, Step, compile_parts, copy_tree
from fishrl.physics.fast.transfer_parts import (
    Occasionally,
    make_filling,
    make_moving,
    make_restriction,
    make_shift_choice,
)
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import locate_markers
from fishrl.physics.levels.grids import Level, find_point, place_patch, plan_levels
from fishrl.physics.levels.patch import RING
from fishrl.physics.levels.transfer import fill_all

Allocate = Callable[[int], Tensor]
Pairs = list[tuple[Tensor, Tensor]]
Place = tuple[Tensor, Tensor]  # origin in the parent, corner in nodes of the finest level
Calls = list[tuple[Part, tuple[Sequence[Tensor], Sequence[Tensor]]]]


class RefinedBatch:
    """Flows with levels in memory; see ``FlowBatch`` for arguments, methods and attributes.

    Between advances ``flow`` has all numbers, in nodes and steps of the finest level. An advance
    hands them to the grids, bodies with positions in their patches, and takes them back.
    """

    def __init__(
        self,
        configs: Sequence[FlowConfig],
        *,
        group_size: int,
        device: torch.device,
        allocate: Allocate,
    ) -> None:
        self._config = configs[0]
        self._settings = {"group_size": group_size, "device": device}
        self._fresh = make_fresh(configs, device)
        self.flow = pytree.tree_map(
            lambda t: t.clone(memory_format=torch.contiguous_format), self._fresh
        )
        self._root = self._add([plan_levels(config) for config in configs], None, allocate)
        self._grids = list(self._root.walk())
        self.groups = self._root.batch.groups
        self._arguments = {
            (part, number): grid.bind(part, number)
            for grid in self._grids[1:]
            for part in grid.transfers
            for number in self.groups
        }
        self._moving = [list(top.walk()) for top in self._root.inside if top.level.follows]
        self._choices = [make_shift_choice([g.level for g in chain]) for chain in self._moving]
        self._moves = [make_moving(device) for _ in self._moving]
        self._begins = {number: Repeater(self._list_located(number)) for number in self.groups}
        self._repeaters = {number: Repeater(self._list_pair(number)) for number in self.groups}
        self._ends = {number: Repeater(self._list_end(number)) for number in self.groups}
        self._params, self._states = self._pair_bodies()

    def _add(self, levels: Sequence[Level], parent: Grid | None, allocate: Allocate) -> Grid:
        """Make a grid of all flows, of which ``levels`` are their own, and those inside it."""
        configs = [level.config for level in levels]
        batch = FlowBatch(configs, allocate=allocate, **self._settings)  # type: ignore[arg-type]
        origin = allocate(16 * len(configs)).view(torch.int64).view(-1, 2)
        size = levels[0].frame.size
        last = torch.tensor(size, dtype=torch.float64, device=origin.device) - 1.0
        grid = Grid(levels[0], batch, origin, last, parent)
        if parent is not None:
            whole = [make_restriction(is_whole=is_whole) for is_whole in (False, True)]
            grid.transfers = (make_filling(*size), *whole)
        for number in range(len(levels[0].patches)):
            inside = [level.patches[number] for level in levels]
            grid.inside.append(self._add(inside, grid, allocate))
        return grid

    def _bind_moves(self, number: int) -> tuple[Tensor, Calls, Calls]:
        """Return a group's moves, what chooses them for patches that follow bodies, and moves."""
        by = torch.zeros_like(self._root.origin[self._root.batch.rows_of(number)])
        by = by.repeat(len(self._grids), 1, 1)
        each = iter(by)
        chains = [[find_moving(grid, number, next(each)) for grid in own] for own in self._moving]
        choices, moves = (
            [(part, part.bind(chain)) for part, chain in zip(parts, chains, strict=True)]
            for parts in (self._choices, self._moves)
        )
        return by, choices, moves

    def _list_pair(self, number: int) -> list[tuple[Step, Sequence[Tensor]]]:
        """Return what an even and an odd step of the coarsest level consist of."""
        by, choices, moves = self._bind_moves(number)
        steps: list[tuple[Step, Sequence[Tensor]]] = []
        for parity in (0, 1):
            steps += [(part, arguments[parity]) for part, arguments in choices]
            fills = [
                (grid.transfers[0], self._arguments[grid.transfers[0], number][at])
                for grid in self._grids[1:]
                for at in [parity if grid.parent is self._root else 0]
            ]  # what lies in the ring moves inwards
            moved = [(part, arguments[parity]) for part, arguments in moves]
            shift = [*fills, *moved, *self._list_located(number)] if moves else []
            if shift and by.device.type == "cpu":
                steps.append((Occasionally(by, Repeater(shift)), ()))
            else:
                steps += shift
            steps += self._list_step(self._root, number, parity)
        return steps

    def _list_step(self, grid: Grid, number: int, parity: int) -> list[Bound]:
        """Return the parts of a step of a grid, and of two of those inside it."""
        filled = [(g.transfers[0], self._arguments[g.transfers[0], number]) for g in grid.inside]
        taken = [(g.transfers[1], self._arguments[g.transfers[1], number]) for g in grid.inside]
        steps = [(part, arguments[parity]) for part, arguments in filled]
        steps += grid.batch.stepper.list_step(grid.batch.groups[number], parity)
        for patch in grid.inside:
            for half in (0, 1):
                steps += self._list_step(patch, number, half)
        return steps + [(part, arguments[1 - parity]) for part, arguments in taken]

    def _list_located(self, number: int) -> list[Bound]:
        """Return what finds out where still bodies and sharp skins are."""
        found: list[Bound] = []
        for grid in self._grids:
            stepper, group = grid.batch.stepper, grid.batch.groups[number]
            if stepper.locate is not None:
                found.append((stepper.locate, group.arguments[stepper.locate][1]))
        return found

    def _list_transfers(self) -> Calls:
        """Return the parts between grids with the first group's arguments."""
        own = [(part, args) for (part, number), args in self._arguments.items() if number == 0]
        _, choices, moves = self._bind_moves(0)
        return [*own, *choices, *moves]

    def compile(self, *, with_check: bool, helps: bool = False) -> None:
        """Compile all parts of all grids."""
        for grid in reversed(self._grids):
            grid.batch.compile(with_check=with_check, helps=helps)
        compile_parts([(part, args[0]) for part, args in self._list_transfers()], helps=helps)

    def compile_check(self) -> None:
        """Compile the checks, and what it takes to read the flows."""
        for grid in self._grids:
            grid.batch.compile_check()

    def is_new(self) -> bool:
        """Return whether ``compile`` would put new code on the disk."""
        own = any(grid.batch.is_new() for grid in self._grids)
        return own or not all(part.is_stored(args[0]) for part, args in self._list_transfers())

    def list_calls(self) -> Calls:
        """Return ``InPlaceSolver.list_calls``, of a step of the coarsest level."""
        even, odd = (self._list_step(self._root, 0, parity) for parity in (0, 1))
        own = [(part, (at, after)) for (part, at), (_, after) in zip(even, odd, strict=True)]
        return [*self._bind_moves(0)[1], *own]

    def initialise_(self) -> None:
        """Write the initial parameters, bodies at rest and relaxation rates."""
        copy_tree(self.flow, self._fresh)
        self.before_()
        for grid in self._grids:
            grid.batch.set_omega_()
        self._place_(torch.ones_like(self.flow.clock, dtype=torch.bool))

    def _place_(self, rows: Tensor) -> None:
        """Put the patches of some flows around their bodies."""
        for grid, (origin, _) in zip(self._grids, self._find_places(self.flow.bodies), strict=True):
            grid.origin.copy_(torch.where(rows[:, None], origin, grid.origin))

    def _find_places(self, bodies: Sequence[BodyState]) -> list[Place]:
        """Return where each grid must lie for bodies to be in the middle of their patches."""
        places = [(torch.zeros_like(self._root.origin),) * 2]
        for grid in self._grids[1:]:
            assert grid.parent is not None
            _, corner = places[self._grids.index(grid.parent)]
            spacing = grid.parent.level.spacing
            place = (find_point(grid.level, bodies, self.flow.clock) - corner) / spacing
            origin = place_patch(place, grid.level.frame)
            places.append((origin, corner + spacing * origin))
        return places

    def check_places(self, bodies: Sequence[BodyState], rows: Tensor) -> None:
        """Raise ValueError for bodies in ``rows`` ``[B]`` that patches cannot hold."""
        if rows.is_cuda and torch.cuda.is_current_stream_capturing():
            return
        places = self._find_places(bodies)
        for is_wrong, problem in (
            (self._find_overlap(places), "patches of {} nodes overlap; move the bodies apart"),
            (~self._find_inside(places, bodies), "a body is not within its patch of {} nodes"),
        ):
            if (is_wrong & rows).any():
                unit = self._root.level.spacing
                sizes = [tuple(unit * (n // 2) for n in g.size) for g in self._root.inside]
                raise ValueError(
                    f"flow {int((is_wrong & rows).int().argmax())}: {problem.format(sizes)}, take "
                    "fewer levels, or give FlowConfig(patches=...) that hold the bodies"
                )

    def _find_overlap(self, places: Sequence[Place]) -> Tensor:
        """Return ``[B]``: whether patches of the root share more than their outermost nodes."""
        found = torch.zeros_like(self.flow.clock, dtype=torch.bool)
        at = dict(zip(map(id, self._grids), places, strict=True))
        for one, other in combinations(self._root.inside, 2):
            gap = at[id(one)][0] - at[id(other)][0]
            ahead, behind = (0.5 * g.last for g in (other, one))
            found |= ((gap < ahead) & (gap > -behind)).all(-1)
        return found

    def _find_inside(self, places: Sequence[Place], bodies: Sequence[BodyState]) -> Tensor:
        """Return ``[B]``: whether all bodies lie where their patches are valid."""
        found = torch.ones_like(self.flow.clock, dtype=torch.bool)
        reach = RING + self._config.skin.margin
        for grid, (_, corner) in zip(self._grids, places, strict=True):
            low = corner[:, None] + reach
            high = low + grid.last - 2 * reach
            for index in grid.level.bodies:
                outline = locate_markers(self.flow.params.bodies[index], bodies[index])
                found &= ((outline > low) & (outline < high)).flatten(1).all(-1)
        return found

    def _pair_bodies(self) -> tuple[Pairs, Pairs]:
        """Return parameters and states of the bodies: tensors of their grids, and of all."""
        params: Pairs = []
        states: Pairs = []
        for grid in self._grids:
            own = grid.batch.flow
            for place, number in enumerate(grid.level.bodies):
                both = own.params.bodies[place], self.flow.params.bodies[number]
                params += zip(*map(pytree.tree_leaves, both), strict=True)
                states += zip(own.bodies[place], self.flow.bodies[number], strict=True)
        return params, states

    def before_(self) -> None:
        """Hand numbers and bodies to the grids."""
        pairs = [*self._params, *self._states]
        for grid in self._grids:
            own, params = grid.batch.flow, grid.level.convert(self.flow.params)
            pairs += zip(own.params[:-1], params[:-1], strict=True)
            pairs.append((own.clock, self.flow.clock / grid.level.spacing))
        _copy(pairs)
        for grid in self._grids:
            for body in grid.batch.flow.bodies:
                body.position.sub_(grid.find_corner())

    def after_(self, wanted: Collection[int]) -> None:
        """Take the numbers of some groups back from the grids."""
        for grid in self._grids:
            for body in grid.batch.flow.bodies:
                body.position.add_(grid.find_corner())
        clock = self._root.batch.flow.clock * self._root.level.spacing
        pairs = [(self.flow.clock, clock), *((given, own) for own, given in self._states)]
        rows = [self._root.batch.rows_of(number) for number in wanted]
        if sum(own.stop - own.start for own in rows) < len(clock):
            pairs = [(to[own], new[own]) for own in rows for to, new in pairs]
        _copy(pairs)

    def advance_(self, num_steps: int, wanted: Collection[int]) -> None:
        """Advance the wanted groups."""
        num_pairs = num_steps // self._root.level.spacing // 2
        for number in self.groups:
            if number in wanted and num_pairs:
                self._begins[number].run(1)
                self._repeaters[number].run(num_pairs)
                self._ends[number].run(1)

    def _list_end(self, number: int) -> list[Bound]:
        """Return what makes all nodes valid, to be read or stored: restriction and filling."""
        whole = [grid.transfers[2] for grid in reversed(self._grids[1:])]
        filled = [grid.transfers[0] for grid in self._grids[1:]]
        return [(part, self._arguments[part, number][0]) for part in (*whole, *filled)]

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set all nodes of the flows in ``rows`` ``[B]`` to populations ``[B]``; place patches."""
        for grid in self._grids:
            grid.batch.fill_(rows, f)
        self._place_(rows)

    @property
    def grids(self) -> list[FlowBatch]:
        """The grids, in the order of ``FlowConfig.list_grids``."""
        return [grid.batch for grid in self._grids]

    def find_corners(self) -> Tensor:
        """Return ``FlowBatch.find_corners``."""
        return torch.stack([grid.find_corner() for grid in self._grids], 1)

    def choose_written(self, rows: Tensor, f: object) -> Tensor:
        """Return the indices of ``rows`` ``[B]`` bool."""
        return rows.nonzero()[:, 0]

    def write_(self, rows: Tensor, f: Sequence[Tensor | None]) -> None:
        """Set populations of each grid, as ``FlowBatch.write_``."""
        for grid, own in zip(self._grids, f, strict=True):
            if own is None and grid.parent is not None:
                parent, origin = grid.parent.batch.populations()[rows], grid.origin[rows]
                tau = grid.level.convert(self.flow.params).tau[rows]
                own = fill_all(grid.size, parent, origin, tau)
            grid.batch.write_(rows, [own])

    def is_fine(self) -> Tensor:
        """Return ``[B]``: density and speed are within the method, and bodies in their patches."""
        places = [(grid.origin, grid.find_corner()) for grid in self._grids]
        fine = self._find_inside(places, self.flow.bodies) & ~self._find_overlap(places)
        return fine & torch.stack([grid.batch.is_fine() for grid in self._grids]).all(0)

    def is_lost(self) -> Tensor:
        """Return ``[B]``: the middle of a grid is not finite."""
        lost = [grid.batch.is_lost() for grid in self._grids]
        return torch.stack(lost).any(0)

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Read density and velocity at points, on the finest grid that holds each."""
        rho, u = self._root.batch.sample(points / self._root.level.spacing)
        for grid in self._grids[1:]:
            own = (points - grid.find_corner()[:, None]) / grid.level.spacing
            inside = ((own >= RING) & (own <= grid.last - RING)).all(-1)
            values = grid.batch.sample(own)
            rho = torch.where(inside, values[0], rho)
            u = torch.where(inside[..., None], values[1], u)
        return rho, u

    def macroscopic(self, rows: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return density ``[N, Y, X]`` and velocity ``[N, 2, Y, X]`` at nodes of the finest level.

        They are those of the N of ``rows`` ``[B]``. Between the nodes of coarser levels they are
        linear.
        """
        field = lay_together(self._grids, self._config, read_fluid)
        field = field if rows is None else field[rows]
        return field[:, 0], field[:, 1:]

    def vorticity(self, rows: Tensor | None = None, is_water: Tensor | None = None) -> Tensor:
        """Return vorticity as ``FlowBatch``, differences being those of each grid's own nodes."""
        read = partial(read_vorticity, is_water=is_water)
        field = lay_together(self._grids, self._config, read)[:, 0]
        return field if rows is None else field[rows]

    def name_state(self) -> dict[str, list[Tensor]]:
        """Return everything that the future depends on, as ``FlowBatch.name_state``."""
        named = name_numbers(self.flow)
        for number, grid in enumerate(self._grids):
            own = grid.batch.name_populations()
            own |= {"origin": [grid.origin]} if number else {}
            named |= {f"patch {number} {name}" if number else name: v for name, v in own.items()}
        return named

    def load_state_(self, state: Mapping[str, Tensor]) -> None:
        """Restore the tensors of ``name_state``."""
        restore_(self.name_state(), state)


def _copy(pairs: Pairs) -> None:
    """Copy the second tensor of each pair to the first."""
    for to, new in pairs:
        to.copy_(new)


def make_batch(
    configs: Sequence[FlowConfig],
    *,
    group_size: int,
    device: torch.device,
    allocate: Allocate,
) -> FlowBatch | RefinedBatch:
    """Return the batch of flows with one level, or with more."""
    kind = FlowBatch if configs[0].levels == 1 else RefinedBatch
    return kind(configs, group_size=group_size, device=device, allocate=allocate)
