"""All flows of a batch in one block of memory, and the step that advances them in this process."""

from collections.abc import Callable, Collection, Sequence

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.state import make_body
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.fast.compiled import Kernel
from fishrl.physics.fast.layout import FlowData, FlowMemory, InPlaceLayout
from fishrl.physics.fast.probes import sample_flow
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
        self.scratch = Scratch(config, self.layout, sample)
        groups = range(len(configs) // group_size) if groups is None else groups
        self.groups = {number: self._make_group(number) for number in groups}
        self.first = self.groups[groups[0]]
        self.stepper = Stepper(config, self.layout, self.first)

    def _make_group(self, number: int) -> FlowGroup:
        own = self._rows(number)
        return FlowGroup(
            config=self._config,
            layout=self.layout,
            scratch=self.scratch,
            populations=self._data[number],
            omega=self._omega[own],
            flow=pytree.tree_map(lambda t: t[own], self.flow),
        )

    def _rows(self, number: int) -> slice:
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

    def find_groups(self, rows: Tensor) -> list[int]:
        """Return the groups of the flows in ``rows`` ``[B]``."""
        return rows.view(-1, self._size).any(-1).nonzero()[:, 0].tolist()

    def advance_(self, num_steps: int, wanted: Collection[int]) -> None:
        """Advance those of this process's groups that are wanted."""
        for number, group in self.groups.items():
            if number in wanted:
                self.stepper.advance_(group, num_steps)

    def fill_(self, rows: Tensor, f: Sequence[Tensor]) -> None:
        """Set the flows in ``rows`` ``[B]`` to uniform populations, nine of ``[B]``."""
        for number, group in self.groups.items():
            own = self._rows(number)
            if self._size > 1 or rows[own].item():
                group.fill_(rows[own], [value[own] for value in f])

    def write_(self, rows: Tensor, f: Tensor) -> None:
        """Set the flows in ``rows`` ``[B]`` to populations ``[B, Q, Y, X]``."""
        for number, group in self.groups.items():
            own = self._rows(number)
            group.write_(rows[own], f[own].unbind(1))

    def read(self) -> Tensor:
        """Return a copy of the incoming populations ``[B, Q, Y, X]``."""
        return torch.cat([torch.stack(group.read(), 1) for group in self.groups.values()])

    def read_macroscopic(self) -> tuple[Tensor, Tensor]:
        """Return density ``[B, Y, X]`` and velocity ``[B, 2, Y, X]``."""
        fluids = [compute_macroscopic(group.read()) for group in self.groups.values()]
        velocities = [torch.stack((fluid.ux, fluid.uy), 1) for fluid in fluids]
        return torch.cat([fluid.rho for fluid in fluids]), torch.cat(velocities)

    def sample(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return density ``[B, P]`` and velocity ``[B, P, 2]`` at points ``[B, P, 2]``."""
        return sample_flow(self._data, self.layout, self._config.storage, points)

    def is_fine(self) -> Tensor:
        """Return ``[B]``: whether everything is finite and slower than ``MAX_SPEED``."""
        return torch.cat([self.stepper.is_fine(group) for group in self.groups.values()])

    def name_state(self) -> list[tuple[str, Tensor]]:
        """Return everything that the future depends on, by name."""
        pairs, _ = pytree.tree_flatten_with_path(self.flow)
        named = [(pytree.keystr(path).lstrip("."), leaf) for path, leaf in pairs]
        # states saved so far call the bodies' parameters "shapes"
        named = [(n.replace("params.bodies", "params.shapes"), leaf) for n, leaf in named]
        return [("data", self._data), ("omega", self._omega), *named]

    def list_calls(self) -> dict[str, list[tuple[Kernel, Sequence[Tensor]]]]:
        """Return each part of a step of the first group: its calls in an even and an odd step."""
        kernels, arguments = self.stepper.kernels, self.first.arguments
        names = [name for name in kernels if name not in ("locate", "check")]
        return {name: [(kernels[name], given) for given in arguments[name]] for name in names}

    def wrap_kernels_(self, wrap: Callable[[str, Kernel], Kernel]) -> None:
        """Replace each part of the step by ``wrap(name, part)``, to measure it."""
        for name in self.list_calls():
            self.stepper.kernels[name] = wrap(name, self.stepper.kernels[name])


def _make_fresh(configs: Sequence[FlowConfig], device: torch.device) -> FlowData:
    """Return the numbers of flows with bodies at rest in the middle of the domain."""
    zero = torch.zeros(len(configs), dtype=torch.float64, device=device)
    middle = torch.tensor([0.5 * configs[0].width, 0.5 * configs[0].height]).double()
    body = make_body(middle.to(device).expand(len(configs), 2), zero, zero)
    return FlowData(zero, make_params(configs, device), tuple(body for _ in configs[0].bodies))
