"""All flows of a batch in one block of memory, and the step that advances them in this process."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.memory import check_memory
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.diagnostics import compute_vorticity
from fishrl.physics.fast.checks import check_tensor
from fishrl.physics.fast.flow_memory import FlowData, GroupMemory, carve_memory
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import FlowGroup, Part, copy_tree
from fishrl.physics.fast.stepper import Stepper
from fishrl.physics.flow import FlowConfig, make_params
from fishrl.torch_state import one_thread


class FlowBatch:
    """Flows in memory, in groups that advance together.

    Args:
        configs: one per flow.
        group_size: flows per group.
        device: where everything lives.
        allocate: makes the block of memory, from its size in bytes.

    ``RefinedBatch`` has the same methods for flows with levels.

    Attributes:
        flow: everything except the populations, changed in place.
        groups: by their number in the batch.
        stepper: the step of all groups.
    """

    def __init__(
        self,
        configs: Sequence[FlowConfig],
        *,
        group_size: int,
        device: torch.device,
        allocate: Callable[[int], Tensor],
    ) -> None:
        config = self._config = configs[0]
        self._size = group_size
        self.layout = InPlaceLayout(num_envs=group_size, height=config.height, width=config.width)
        self._fresh = make_fresh(configs, device)
        self.flow, self._omega, self._populations = carve_memory(
            self._fresh,
            self.layout,
            has_omega_field=bool(config.sponges),
            allocate=allocate,
        )
        self.stepper = Stepper(
            config, self.layout, pytree.tree_map(lambda t: t[:group_size], self._fresh)
        )
        layout = self.layout
        self._last = torch.tensor([layout.width - 1.0, layout.height - 1.0], device=device)
        slots = torch.tensor(layout.offsets(0, False), device=device)
        self._slots = slots.view(-1, 1, 1, 1)  # of the nine populations
        self.groups = {
            number: FlowGroup(self.memory_of(number), self.stepper.list_all())
            for number in range(len(configs) // group_size)
        }
        self.first = self.groups[0]

    def memory_of(self, number: int) -> GroupMemory:
        """Return a group's part of the memory."""
        own = self.rows_of(number)
        return GroupMemory(
            layout=self.layout,
            populations=self._populations[number],
            omega=self._omega[own],
            flow=pytree.tree_map(lambda t: t[own], self.flow),
        )

    def rows_of(self, number: int) -> slice:
        """Return which flows of the batch are in a group."""
        return slice(number * self._size, (number + 1) * self._size)

    def initialise_(self) -> None:
        """Write the initial parameters, bodies at rest and relaxation rates."""
        copy_tree(self.flow, self._fresh)
        self.set_omega_()

    def set_omega_(self) -> None:
        """Write the relaxation rates of the present parameters."""
        omega = self._config.compute_omega(self.flow.params.tau)
        if omega.shape[1:] == (1, 1):
            self._omega.copy_(omega[:, 0])
        else:
            self._omega.fill_(1.0)
            self.layout.strip_rings(self._omega).copy_(omega)

    def compile(self, *, with_check: bool, helps: bool = False) -> None:
        """Compile the step, as ``Stepper.compile``."""
        self.stepper.compile(self.first, with_check=with_check, helps=helps)
        self._forget_checks()

    def compile_check(self) -> None:
        """Compile the check alone, for a process that reads flows which others advance."""
        self.stepper.check.compile(self.first.arguments[self.stepper.check][0])
        self._forget_checks()

    def _forget_checks(self) -> None:
        """Let checks that ran before they were compiled be made again."""
        for group in self.groups.values():
            group.checker = None

    def is_new(self) -> bool:
        """Return whether ``compile`` would put new code on the disk."""
        return self.stepper.is_new(self.first)

    def list_calls(self) -> list[tuple[Part, tuple[Sequence[Tensor], Sequence[Tensor]]]]:
        """Return ``InPlaceSolver.list_calls``."""
        return [(part, self.first.arguments[part]) for part in self.stepper.parts]

    def check_places(self, bodies: Sequence[BodyState], rows: Tensor) -> None:
        """Raise ValueError for bodies that may not be where they are: none, with one level."""

    def before_(self) -> None:
        """Prepare an advance, in the process that reads the flows: nothing, with one level."""

    def after_(self, wanted: Collection[int]) -> None:
        """End it."""

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set all nodes of the flows in ``rows`` ``[B]`` bool to the populations ``[B]``."""
        for number, group in self.groups.items():
            own = self.rows_of(number)
            if rows.is_cuda or self._size > 1 or rows[own].item():
                group.fill_(rows[own], [value[own] for value in f])

    @property
    def grids(self) -> "list[FlowBatch]":
        """The grids, coarsest first: this one alone, with one level."""
        return [self]

    def find_corners(self) -> Tensor:
        """Return the place ``[B, G, 2]`` int64 of the first node of each grid, finest nodes."""
        return self.flow.clock.new_zeros(len(self.flow.clock), 1, 2, dtype=torch.int64)

    def choose_written(self, rows: Tensor, f: Tensor | Sequence[Tensor | None]) -> Tensor:
        """Return the rows for ``write_``: ``[B]`` bool on a GPU, if ``f`` is of all flows."""
        first = f if isinstance(f, Tensor) else f[0]
        is_whole = first is not None and len(first) == len(rows)
        return rows if rows.is_cuda and is_whole else rows.nonzero()[:, 0]

    def write_(self, rows: Tensor, f: Sequence[Tensor | None]) -> None:
        """Set populations of each grid; see ``InPlaceSolver.set_populations_``.

        ``rows`` ``[N]`` are indices, or ``[B]`` bool, and then ``f`` is of all flows.
        """
        (given,) = f
        assert given is not None  # as checked: there is no parent
        if rows.dtype == torch.bool:
            for number, group in self.groups.items():
                part = self.rows_of(number)
                group.merge_(rows[part], given[part].to(self._populations))
            return
        for number in sorted(set((rows // self._size).tolist())):
            is_own = rows // self._size == number
            own = given.to(self._populations)[is_own]
            self.groups[number].write_(rows[is_own] % self._size, own)

    def populations(self) -> Tensor:
        """Return a copy of the incoming populations ``[B, Q, Y, X]``."""
        return torch.cat([torch.stack(group.nodes, 1) for group in self.groups.values()])

    def macroscopic(self, rows: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return density ``[N, Y, X]`` and velocity ``[N, 2, Y, X]`` of flows ``rows`` ``[B]``."""
        fluids = []
        for number, group in self.groups.items():
            nodes: Sequence[Tensor] = group.nodes
            if rows is not None and not (own := rows[self.rows_of(number)]).all():
                nodes = [f[own] for f in nodes]
            fluids.append(compute_macroscopic(nodes))
        velocities = [torch.stack((fluid.ux, fluid.uy), 1) for fluid in fluids]
        return torch.cat([fluid.rho for fluid in fluids]), torch.cat(velocities)

    def vorticity(self, rows: Tensor | None = None, is_water: Tensor | None = None) -> Tensor:
        """Return vorticity ``[N, Y, X]`` of flows ``rows`` ``[B]``; see ``compute_vorticity``."""
        water = is_water if is_water is None or rows is None else is_water[rows]
        return compute_vorticity(self.macroscopic(rows)[1], is_water=water)

    def is_fine(self) -> Tensor:
        """Return ``[B]``: whether density and speed are within the method."""
        with one_thread():  # several would wait for each other, on a busy machine for seconds
            return torch.cat([self.stepper.is_fine(group) for group in self.groups.values()])

    def advance_(self, num_steps: int, wanted: Collection[int]) -> None:
        """Advance the wanted groups."""
        for number, group in self.groups.items():
            if number in wanted:
                self.stepper.advance_(group, num_steps)

    def is_lost(self) -> Tensor:
        """Return ``[B]``: the middle is not finite, which all of a diverged flow soon becomes."""
        y, x = self.layout.height // 2, self.layout.width // 2
        return torch.cat([~group.nodes[0][:, y, x].isfinite() for group in self.groups.values()])

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Read density ``[B, P]`` and velocity ``[B, P, 2]`` between the nodes, bilinearly.

        ``points`` ``[B, P, 2]`` (x, y) in nodes, before an even step: those outside the grid are
        moved to its edge, and where one is NaN, so is the result.
        """
        layout, device, last = self.layout, points.device, self._last.to(points)
        place = torch.minimum(points.nan_to_num().clamp_min(0.0), last)
        first = torch.minimum(place.floor(), last - 1.0)
        right, up = (place - first).float().unbind(-1)
        x, y = first.long().unbind(-1)
        node = y * layout.row_length + x
        above = node + layout.row_length
        corners = torch.stack((node, node + 1, above, above + 1), 1)
        weights = torch.stack(
            ((1 - up) * (1 - right), (1 - up) * right, up * (1 - right), up * right), 1
        )
        flow = torch.arange(len(points), device=device)[:, None, None]
        group, own = flow // layout.num_envs, flow % layout.num_envs
        cells = corners + own * layout.flow_length + layout.first_cell
        stored = self._populations[group, cells + self._slots]
        fluid = compute_macroscopic(stored.unbind())
        values = torch.stack((fluid.rho, fluid.ux, fluid.uy), -1)
        mean = (weights[..., None] * values).sum(1)
        mean = mean.masked_fill(points.isnan().any(-1, keepdim=True), torch.nan)
        return mean[..., 0], mean[..., 1:]

    def name_state(self) -> dict[str, list[Tensor]]:
        """Return everything that the future depends on, by name, each in groups of flows.

        ``f0`` to ``f8`` are the incoming populations ``[B, Y, X]`` before an even step.
        """
        return {**self.name_populations(), **name_numbers(self.flow)}

    def name_populations(self) -> dict[str, list[Tensor]]:
        """Return populations and relaxation rates, for ``name_state``."""
        nodes = zip(*(group.nodes for group in self.groups.values()), strict=True)
        populations = {f"f{q}": list(views) for q, views in enumerate(nodes)}
        return {**populations, "omega": [self._omega]}

    def load_state_(self, state: Mapping[str, Tensor]) -> None:
        """Restore the tensors of ``name_state``, each of all flows ``[B, ...]``.

        Raises:
            ValueError: for a state of another grid, batch or version.
        """
        restore_(self.name_state(), state)


def name_numbers(flow: FlowData) -> dict[str, list[Tensor]]:
    """Return the numbers of flows, for ``FlowBatch.name_state``."""
    pairs, _ = pytree.tree_flatten_with_path(flow)
    return {pytree.keystr(path).lstrip("."): [leaf] for path, leaf in pairs}


def restore_(own: Mapping[str, Sequence[Tensor]], state: Mapping[str, Tensor]) -> None:
    """Copy saved tensors ``[B, ...]`` into those of ``name_state``, as ``load_state_``."""
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


def set_rows_(own: Any, new: Any, rows: Tensor, *, name: str) -> None:
    """Copy ``rows`` ``[B]`` bool of all tensors ``[B, ...]`` of the nested tuple ``new``.

    Raises:
        ValueError: if forms or shapes differ; then nothing has changed.
    """
    pairs = list(zip(pytree.tree_leaves(own), pytree.tree_leaves(new), strict=True))
    for before, after in pairs:
        check_tensor(name, after, tuple(before.shape))
    for before, after in pairs:
        chosen = rows.view(-1, *(1,) * (before.dim() - 1))
        before.copy_(torch.where(chosen, after, before))


def make_fresh(configs: Sequence[FlowConfig], device: torch.device) -> FlowData:
    """Return the initial numbers of flows, with bodies at rest in the middle of the domain."""
    zero = torch.zeros(len(configs), dtype=torch.float64, device=device)
    middle = torch.tensor([0.5 * configs[0].width, 0.5 * configs[0].height]).double()
    body = make_body(middle.to(device).expand(len(configs), 2), zero, zero)
    return FlowData(zero, make_params(configs, device), tuple(body for _ in configs[0].bodies))


def list_configs(
    config: FlowConfig | Sequence[FlowConfig],
    num_envs: int | None,
    device: torch.device | str = "cpu",
) -> list[FlowConfig]:
    """Return one configuration per flow.

    Raises:
        ValueError: if there are not ``num_envs`` of them, or their populations exceed the memory.
    """
    if isinstance(config, FlowConfig):
        num_envs = 1 if num_envs is None else num_envs
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs}: at least one flow is needed")
        check_memory(device=device, flows=num_envs * config.num_bytes)
        return [config] * num_envs
    if not config or num_envs not in (None, len(config)):
        raise ValueError(
            f"num_envs = {num_envs} with {len(config)} configurations: give one per flow"
        )
    check_memory(device=device, flows=sum(one.num_bytes for one in config))
    return list(config)
