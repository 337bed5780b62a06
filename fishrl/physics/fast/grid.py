"""One grid of a batch of flows: its populations in one block of memory, and the parts of its step.

Order of one step: collide all nodes without force (one pass, 72 bytes a node), then let the bodies
act on the outgoing populations at their marker nodes alone, then set the edges. As collision
conserves mass and momentum, the bodies see the same unforced velocity as in the readable
``step.step``, and the increment they add makes the result equal to the forced collision there. Even
and odd steps are the same code on other views (see ``layout.py``); states are read and written at
even parity only.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import make_body
from fishrl.physics.collision import Macroscopic, compute_macroscopic
from fishrl.physics.fast.body_parts import make_skin_parts
from fishrl.physics.fast.flow_memory import FlowData, GroupMemory, carve_memory
from fishrl.physics.fast.fluid_parts import make_check, make_collision, make_crossing, make_edges
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import Bound, Part, Repeater
from fishrl.physics.flow import FlowConfig, make_params
from fishrl.physics.levels.grids import Level

Allocate = Callable[[int], Tensor]


class Grid:
    """One grid of all flows, in groups that advance together.

    Args:
        levels: the grid in each flow.
        group_size: flows per group.
        device: where everything lives.
        allocate: makes the block of memory, from its size in bytes.

    Attributes:
        level: the grid in the first flow.
        flow: everything except the populations, changed in place.
        origin: ``[B, 2]`` int64, of its first node in its parent; the root's is 0.
        last: ``[2]`` float64, (x, y) of the last node in its own nodes.
        arguments: of each group, those of each part before even and odd steps.
        nodes: the nine incoming populations ``[groups, flows, Y, X]`` before an even step.
        parts: those of a step, in the order in which they run.
        locate: finds bodies that stay still, or sharp skins, once before many steps.
        check: finds out which flows are within the method.
    """

    def __init__(
        self,
        levels: Sequence[Level],
        *,
        group_size: int,
        device: torch.device,
        allocate: Allocate,
    ) -> None:
        self.level, config, num_envs = levels[0], levels[0].config, len(levels)
        self._size, has_field = group_size, bool(config.sponges)
        self.layout = InPlaceLayout(num_envs=group_size, height=config.height, width=config.width)
        fresh = make_fresh([level.config for level in levels], device)
        self.flow, self._omega, self._populations = carve_memory(
            fresh, self.layout, has_omega_field=has_field, allocate=allocate
        )
        self.origin = allocate(16 * num_envs).view(torch.int64).view(-1, 2)
        sample = pytree.tree_map(lambda t: t[:group_size], fresh)
        self.locate: Part | None = None
        self.parts: list[Part] = [make_collision(config)]
        if config.bodies:
            self.locate, parts = make_skin_parts(config.skin, config, self.layout, sample)
            self.parts += parts
        if config.boundaries.list_crossings(config.height, config.width):
            self.parts.append(make_crossing(config))
        self.parts += [make_edges(config, sides, device) for sides in config.boundaries.in_order()]
        self._is_fine = torch.zeros(group_size, dtype=torch.bool, device=device)
        self.check = make_check(self._is_fine)
        located = [self.locate] if self.locate and self.locate not in self.parts else []
        every = [*self.parts, *located, self.check]
        memories = [self.memory_of(number) for number in range(num_envs // group_size)]
        self.arguments = [{part: part.bind(memory) for part in every} for memory in memories]
        self.nodes, self._cells = (
            [self._join_groups(view) for view in views]
            for views in (memories[0].incoming(0), memories[0].cells(0))
        )
        self._checkers: list[Repeater] = []
        last = [config.width - 1.0, config.height - 1.0]
        self.last = torch.tensor(last, dtype=torch.float64, device=device)
        slots = torch.tensor(self.layout.offsets(0, False), device=device)
        self._slots = slots.view(-1, 1, 1, 1)  # of the nine populations

    def memory_of(self, number: int) -> GroupMemory:
        """Return a group's part of the memory."""
        own = self.rows_of(number)
        return GroupMemory(
            layout=self.layout,
            populations=self._populations[number],
            omega=self._omega[own],
            flow=pytree.tree_map(lambda t: t[own], self.flow),
        )

    def _join_groups(self, view: Tensor) -> Tensor:
        """Return a view ``[flows, ...]`` of the first group as one of all, ``[groups, ...]``."""
        num_groups, length = self._populations.shape
        return view.as_strided((num_groups, *view.shape), (length, *view.stride()))

    def rows_of(self, number: int) -> slice:
        """Return which flows of the batch are in a group."""
        return slice(number * self._size, (number + 1) * self._size)

    def set_omega_(self) -> None:
        """Write the relaxation rates of the present parameters."""
        omega = self.level.config.compute_omega(self.flow.params.tau)
        if omega.shape[1:] == (1, 1):
            self._omega.copy_(omega[:, 0])
        else:
            self._omega.fill_(1.0)
            self.layout.strip_rings(self._omega).copy_(omega)

    def list_step(self, number: int, parity: int) -> list[Bound]:
        """Return the parts of an even (0) or odd (1) step in order, with a group's arguments."""
        return [(part, self.arguments[number][part][parity]) for part in self.parts]

    def list_located(self, number: int) -> list[Bound]:
        """Return what locates a group's bodies, as after an odd step."""
        parts = [self.locate] if self.locate else []
        return [(part, self.arguments[number][part][1]) for part in parts]

    def list_all(self, with_check: bool) -> list[Bound]:
        """Return all parts with arguments, the longest not last: so processes end together."""
        collision, *rest = self.arguments[0]
        chosen = [part for part in rest if with_check or part is not self.check]
        return [(part, self.arguments[0][part][0]) for part in (*chosen, collision)]

    def forget_checks(self) -> None:
        """Let checks that ran before they were compiled be made again."""
        self._checkers = []

    def is_fine(self) -> Tensor:
        """Return ``[B]``: whether density and speed are within the method, before an even step."""
        if not self._checkers:
            each = [(self.check, own[self.check][0]) for own in self.arguments]
            self._checkers = [Repeater([bound]) for bound in each]
        found = []
        for checker in self._checkers:
            checker.run(1)
            found.append(self._is_fine.clone())
        return torch.cat(found)

    def is_lost(self) -> Tensor:
        """Return ``[B]``: the middle is not finite, which all of a diverged flow soon becomes."""
        y, x = self.layout.height // 2, self.layout.width // 2
        return ~self.nodes[0][..., y, x].isfinite().flatten()

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set all nodes of the flows in ``rows`` ``[B]`` bool to the populations ``[B]``."""
        for view, value in zip(self._cells, f, strict=True):
            self._set_(view, rows, value[:, None])

    def write_(self, rows: Tensor, f: Tensor) -> None:
        """Set populations; ``rows`` ``[N]`` are indices, or ``[B]`` bool, then ``f`` is of all."""
        f = f.to(self._populations)
        for view, values in zip(self.nodes, f.unbind(1), strict=True):
            if rows.dtype == torch.bool:
                self._set_(view, rows, values)
            else:
                view[rows // self._size, rows % self._size] = values

    def _set_(self, view: Tensor, rows: Tensor, values: Tensor) -> None:
        """Set ``rows`` ``[B]`` bool of a view to theirs among the values ``[B, ...]`` of all."""
        if rows.is_cuda:  # to see on the host which they are would be to wait
            chosen = rows.view(-1, self._size, *(1,) * (view.dim() - 2))
            view.copy_(torch.where(chosen, values.unflatten(0, (-1, self._size)), view))
        else:
            own = rows.nonzero()[:, 0]
            view[own // self._size, own % self._size] = values[own].to(view)

    def populations(self) -> Tensor:
        """Return a copy of the incoming populations ``[B, Q, Y, X]``."""
        return torch.stack(self.nodes, 2).flatten(0, 1)

    def read(self, rows: Tensor | None = None) -> Macroscopic:
        """Return the fluid ``[N, Y, X]`` of the flows ``rows`` ``[B]``."""
        nodes = [view.flatten(0, 1) for view in self.nodes]
        return compute_macroscopic(nodes if rows is None else [view[rows] for view in nodes])

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Read density ``[B, P]`` and velocity ``[B, P, 2]`` between the nodes, bilinearly.

        ``points`` ``[B, P, 2]`` (x, y) in nodes, before an even step: those outside the grid are
        moved to its edge, and where one is NaN, so is the result.
        """
        layout, device, last = self.layout, points.device, self.last.to(points)
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
        """Return populations ``f0`` to ``f8`` before an even step, and relaxation rates."""
        populations = {f"f{q}": list(view) for q, view in enumerate(self.nodes)}
        return {**populations, "omega": [self._omega]}


def make_fresh(configs: Sequence[FlowConfig], device: torch.device) -> FlowData:
    """Return the initial numbers of flows, with bodies at rest in the middle of the domain."""
    zero = torch.zeros(len(configs), dtype=torch.float64, device=device)
    middle = torch.tensor([0.5 * configs[0].width, 0.5 * configs[0].height]).double()
    body = make_body(middle.to(device).expand(len(configs), 2), zero, zero)
    return FlowData(zero, make_params(configs, device), tuple(body for _ in configs[0].bodies))
