"""All flows of a batch in one block of memory, and the step that advances them in this process."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import make_body
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.fast.checks import check_tensor
from fishrl.physics.fast.coupled import has_kernel
from fishrl.physics.fast.layout import FlowData, FlowMemory, InPlaceLayout
from fishrl.physics.fast.step import FlowGroup, Scratch, Stepper
from fishrl.physics.flow import FlowConfig, make_params


class FlowBatch:
    """Flows in memory, in groups that advance together.

    Args:
        configs: one per flow.
        group_size: flows per group.
        device: where everything lives.
        allocate: makes the block of memory, from its size in bytes.
        groups: those that this process reads and advances; None is all.
        compile: whether the step will be compiled; on a GPU, a kernel then couples the bodies.

    Attributes:
        flow: all numbers beside the populations, changed in place.
    """

    def __init__(
        self,
        configs: Sequence[FlowConfig],
        *,
        group_size: int,
        device: torch.device,
        allocate: Callable[[int], Tensor],
        groups: range | None = None,
        compile: bool = False,
    ) -> None:
        config = self._config = configs[0]
        self._size = group_size
        self.layout = InPlaceLayout(num_envs=group_size, height=config.height, width=config.width)
        self._fresh = _make_fresh(configs, device)
        memory = FlowMemory(
            self._fresh,
            self.layout,
            dtype=config.storage.dtype,
            has_omega_field=bool(config.sponges),
        )
        self.num_bytes = memory.count_bytes()
        self.flow, self._omega, self._data = memory.carve(allocate(self.num_bytes))
        sample = pytree.tree_map(lambda t: t[:group_size], self._fresh)
        is_coupled = compile and has_kernel(config, device)
        self.scratch = Scratch(config, self.layout, sample, is_coupled)
        groups = range(len(configs) // group_size) if groups is None else groups
        self.groups = {number: self._make_group(number) for number in groups}
        self.first = self.groups[groups[0]]
        self.stepper = Stepper(config, self.layout, self.first, is_coupled)

    def _make_group(self, number: int) -> FlowGroup:
        own = self.rows_of(number)
        return FlowGroup(
            config=self._config,
            layout=self.layout,
            scratch=self.scratch,
            populations=self._data[number],
            omega=self._omega[own],
            flow=pytree.tree_map(lambda t: t[own], self.flow),
        )

    def rows_of(self, number: int) -> slice:
        """Return which flows of the batch are in a group."""
        return slice(number * self._size, (number + 1) * self._size)

    def initialise_(self) -> None:
        """Write what flows begin with: parameters, bodies at rest and relaxation rates."""
        pairs = zip(pytree.tree_leaves(self.flow), pytree.tree_leaves(self._fresh), strict=True)
        for own, new in pairs:
            own.copy_(new)
        omega = self._config.compute_omega(self.flow.params.tau)
        if omega.shape[1:] == (1, 1):
            self._omega.copy_(omega[:, 0])
        else:
            self._omega.fill_(1.0)
            self.layout.strip_rings(self._omega).copy_(omega)

    def advance_(self, num_steps: int, wanted: Collection[int]) -> None:
        """Advance those of this process's groups that are wanted."""
        for number, group in self.groups.items():
            if number in wanted:
                self.stepper.advance_(group, num_steps)

    def is_lost(self) -> Tensor:
        """Return ``[B]``: the middle is not finite, which all of a diverged flow soon becomes."""
        y, x = self.layout.height // 2, self.layout.width // 2
        return torch.cat([~group.nodes[0][:, y, x].isfinite() for group in self.groups.values()])

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Read density and velocity between the nodes, bilinearly, before an even step.

        Args:
            points: ``[B, P, 2]`` (x, y) in nodes; those outside the grid are moved to its edge,
                and where one is NaN, so is the result.

        Returns:
            Density ``[B, P]`` and velocity ``[B, P, 2]``, float32.
        """
        layout, decode, device = self.layout, self._config.storage.decode, points.device
        last = torch.tensor([layout.width - 1.0, layout.height - 1.0], device=device)
        place = torch.minimum(points.nan_to_num().clamp_min(0.0), last.to(points))
        first = torch.minimum(place.floor(), last.to(points) - 1.0)
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
        f = [decode(self._data[group, cells + offset]) for offset in layout.offsets(0, False)]
        fluid = compute_macroscopic(f)
        values = torch.stack((fluid.rho, fluid.ux, fluid.uy), -1)
        mean = (weights[..., None] * values).sum(1)
        mean = mean.masked_fill(points.isnan().any(-1, keepdim=True), torch.nan)
        return mean[..., 0], mean[..., 1:]

    def name_state(self) -> dict[str, list[Tensor]]:
        """Return everything that the future depends on, by name, each in groups of flows.

        ``f0`` to ``f8`` are the incoming populations ``[B, Y, X]`` before an even step, as stored.
        """
        pairs, _ = pytree.tree_flatten_with_path(self.flow)
        named = {pytree.keystr(path).lstrip("."): [leaf] for path, leaf in pairs}
        # states saved so far call the bodies' parameters "shapes"
        named = {n.replace("params.bodies", "params.shapes"): leaf for n, leaf in named.items()}
        nodes = zip(*(group.nodes for group in self.groups.values()), strict=True)
        populations = {f"f{q}": list(views) for q, views in enumerate(nodes)}
        return {**populations, "omega": [self._omega], **named}

    def load_state_(self, state: Mapping[str, Tensor]) -> None:
        """Restore the tensors of ``name_state``, each of all flows ``[B, ...]``.

        Raises:
            ValueError: for a state of another grid, batch, storage or version.
        """
        state = self._read_former(state)
        own_state = self.name_state()
        for name, own in own_state.items():
            shape = (len(self.flow.clock), *own[0].shape[1:])
            expected = f"{own[0].dtype} of shape {shape}"
            saved = state.get(name)
            got = "nothing" if saved is None else f"{saved.dtype} of shape {tuple(saved.shape)}"
            if got != expected:
                raise ValueError(
                    f"state '{name}' is {got}, expected {expected}: it was saved by a solver of "
                    "another grid, batch, storage or version"
                )
        for name, own in own_state.items():
            for part, saved in zip(own, torch.split(state[name], len(own[0])), strict=True):
                part.copy_(saved)

    def _read_former(self, state: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """Return a state as of today for one that was saved formerly.

        That held the memory of the populations itself as ``data`` ``[groups, slots]`` in place of
        ``f0`` to ``f8``, streams only rose from rest, and fish had their gait's amplitude.
        """
        began = ("params.former_speed", "params.ramp_start")
        added = {name: torch.zeros_like(self.flow.clock) for name in began}
        shares = (".amplitude", ".amplitude_goal")
        beats = [name for name in self.name_state() if name.endswith(shares)]
        added |= {name: torch.ones_like(self.flow.clock) for name in beats}
        state = added | dict(state)
        if "data" not in state:
            return state
        data, height, width = state["data"], self.layout.height, self.layout.width
        size = len(self.flow.clock) // len(data)
        layout = InPlaceLayout(num_envs=size, height=height, width=width)
        if data.shape[1] != layout.num_slots:
            return state
        groups = zip(*(layout.nodes(row, 0, False) for row in data), strict=True)
        return {**state, **{f"f{q}": torch.cat(views) for q, views in enumerate(groups)}}


def set_rows_(own: Any, new: Any, rows: Tensor, *, name: str) -> None:
    """Set the rows ``[B]`` bool of all tensors ``[B, ...]`` of a nested tuple to those of another.

    Raises:
        ValueError: if it is not of the same form and shapes; then nothing has changed.
    """
    pairs = list(zip(pytree.tree_leaves(own), pytree.tree_leaves(new), strict=True))
    for before, after in pairs:
        check_tensor(name, after, tuple(before.shape))
    for before, after in pairs:
        chosen = rows.view(-1, *(1,) * (before.dim() - 1))
        before.copy_(torch.where(chosen, after, before))


def _make_fresh(configs: Sequence[FlowConfig], device: torch.device) -> FlowData:
    """Return the numbers of flows with bodies at rest in the middle of the domain."""
    zero = torch.zeros(len(configs), dtype=torch.float64, device=device)
    middle = torch.tensor([0.5 * configs[0].width, 0.5 * configs[0].height]).double()
    body = make_body(middle.to(device).expand(len(configs), 2), zero, zero)
    return FlowData(zero, make_params(configs, device), tuple(body for _ in configs[0].bodies))
