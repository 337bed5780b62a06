"""The bodies' parts of the fast step, as tensor operations on any device."""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.bounce_back import (
    Skin,
    Slots,
    bounce_off_bodies_,
    locate_skin,
    make_lattice,
    uncover_nodes_,
)
from fishrl.physics.collision import compute_force_increment, compute_macroscopic
from fishrl.physics.fast.flow_memory import FlowData, GroupMemory
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import Part, copy_tree
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import BodyGeometry, locate_bodies
from fishrl.physics.lattice import Q
from fishrl.physics.step import couple_bodies

Tree = TypeVar("Tree", bound=tuple[object, ...])

BODY_TITLE = "bodies: markers, force, motion, spreading"
BODY_SETTINGS: dict[str, dict[str, object]] = {
    # The part is small and scatters: one thread, and weights are kept, not computed again for every
    # pair of markers (six times slower at L = 100).
    "cpu": {"cpp.threads": 1, "realize_opcount_threshold": 10},
    # On a GPU launches count: Inductor puts kernels that do not depend on each other into one.
    "cuda": {"combo_kernels": True},
}


class MarkerCells:
    """Where the outgoing populations around the markers lie.

    Attributes:
        first_cell: ``[B]`` int64, cell of each flow's node (0, 0).
        offsets: by parity ``[Q]`` int64, of each outgoing population's slots.
    """

    def __init__(self, layout: InPlaceLayout, device: torch.device) -> None:
        flows = torch.arange(layout.num_envs, device=device)
        self.first_cell = flows * layout.flow_length + layout.first_cell
        self.offsets = [torch.tensor(layout.offsets(p, True), device=device) for p in (0, 1)]


def keep_geometry(config: FlowConfig, sample: FlowData) -> BodyGeometry:
    """Return memory for a geometry of the bodies, with the ``sample``'s content."""
    return _keep(locate_bodies(config, sample.params.bodies, sample.bodies, torch.float32))


def _keep(tree: Tree) -> Tree:
    kept: Tree = pytree.tree_map(lambda t: t.clone(memory_format=torch.contiguous_format), tree)
    return kept


class LocateTensors(NamedTuple):
    """The bodies, and the geometry that follows from them."""

    params: tuple[BodyParams, ...]
    bodies: tuple[BodyState, ...]
    geometry: BodyGeometry


class LocateStill(Part[LocateTensors]):
    """Find the geometry of bodies that never move, once before many steps."""

    title = BODY_TITLE
    settings = BODY_SETTINGS

    def __init__(self, config: FlowConfig, geometry: BodyGeometry) -> None:
        super().__init__()
        self._config, self._geometry = config, geometry

    def collect(self, memory: GroupMemory, parity: int) -> LocateTensors:
        """Return the same at even and odd steps."""
        return LocateTensors(memory.flow.params.bodies, memory.flow.bodies, self._geometry)

    def act(self, tensors: LocateTensors) -> None:
        """Write the geometry."""
        params, bodies, geometry = tensors
        copy_tree(geometry, locate_bodies(self._config, params, bodies, torch.float32))


class CoupleTensors(NamedTuple):
    """What ``CoupleBodies`` reads and writes.

    Attributes:
        data: populations of the group, as stored.
        offsets: ``[Q]`` int64, see ``MarkerCells``.
        first_cell: ``[B]`` int64.
        omega: ``[B, 1]`` or ``[B, cells]``.
        force: (x, y) ``[cells]``, zero between steps.
        params: parameters of each body.
        bodies: state of each body.
        geometry: geometry of bodies that stay still; empty for others.
    """

    data: Tensor
    offsets: Tensor
    first_cell: Tensor
    omega: Tensor
    force: tuple[Tensor, Tensor]
    params: tuple[BodyParams, ...]
    bodies: tuple[BodyState, ...]
    geometry: BodyGeometry | tuple[()]


class CoupleBodies(Part[CoupleTensors]):
    """Let the bodies read the fluid, move, and put their force into the populations.

    ``geometry`` belongs to bodies that stay still; others are located in each step.
    """

    title = BODY_TITLE
    settings = BODY_SETTINGS

    def __init__(
        self,
        config: FlowConfig,
        layout: InPlaceLayout,
        geometry: BodyGeometry | None,
        device: torch.device,
    ) -> None:
        super().__init__()
        self._config, self._layout, self._geometry = config, layout, geometry or ()
        self._cells = MarkerCells(layout, device)
        self.force = tuple(torch.zeros(layout.num_cells, device=device) for _ in range(2))

    def collect(self, memory: GroupMemory, parity: int) -> CoupleTensors:
        """Return populations and bodies of the group, and the memory that groups share."""
        force_x, force_y = self.force
        return CoupleTensors(
            data=memory.populations,
            offsets=self._cells.offsets[parity],
            first_cell=self._cells.first_cell,
            omega=memory.omega,
            force=(force_x, force_y),
            params=memory.flow.params.bodies,
            bodies=memory.flow.bodies,
            geometry=self._geometry,
        )

    def act(self, tensors: CoupleTensors) -> None:
        """Couple as in ``step.couple_bodies``, at the marker nodes alone."""
        config, layout = self._config, self._layout
        data, offsets, first_cell, omega, (force_x, force_y), params, bodies, geometry = tensors
        geometry = geometry or locate_bodies(config, params, bodies, torch.float32)
        nodes = geometry.stencil.index_nodes(layout.row_length) + first_cell[:, None, None]
        slots = [nodes + offsets[q] for q in range(Q)]
        fluid = compute_macroscopic([config.storage.decode(data[slot]) for slot in slots])
        moved, share_x, share_y = couple_bodies(config, params, bodies, geometry, fluid)
        force_x.index_put_((nodes,), share_x, accumulate=True)
        force_y.index_put_((nodes,), share_y, accumulate=True)
        if config.sponges:  # each node has its own
            own = geometry.stencil.index_nodes(config.width)
            rates = layout.strip_rings(omega).flatten(1).gather(1, own.flatten(1)).view_as(own)
        else:
            rates = omega[..., None]
        increment = compute_force_increment(
            fluid, (force_x[nodes], force_y[nodes]), rates, config.rates, share=(share_x, share_y)
        )
        for slot, values in zip(slots, increment, strict=True):
            data.index_put_((slot,), config.storage.encode(values), accumulate=True)
        for total in (force_x, force_y):
            total.index_put_((nodes,), torch.zeros_like(fluid.drho))
        copy_tree(bodies, moved)


def keep_skin(config: FlowConfig, sample: FlowData) -> Skin:
    """Return memory for the skins of the bodies, with the ``sample``'s content."""
    return _keep(locate_skin(config, sample.params.bodies, sample.bodies))


class SkinTensors(NamedTuple):
    """Populations as ``Slots`` holds them, the bodies, and their skins before and after a step."""

    data: Tensor
    offsets: Tensor
    first_cell: Tensor
    lattice: Tensor
    params: tuple[BodyParams, ...]
    bodies: tuple[BodyState, ...]
    before: Skin
    after: Skin


class _SkinPart(Part[SkinTensors]):
    """A part that acts at the skins; ``skins`` holds them before even and before odd steps."""

    title = BODY_TITLE
    settings = BODY_SETTINGS

    def __init__(self, config: FlowConfig, layout: InPlaceLayout, skins: Sequence[Skin]) -> None:
        super().__init__()
        self._config, self._layout, self._skins = config, layout, skins
        device = skins[0].links[0].x.device
        self._cells, self._lattice = MarkerCells(layout, device), make_lattice(device)

    def collect(self, memory: GroupMemory, parity: int) -> SkinTensors:
        """Return populations and bodies of the group, and the memory that groups share."""
        return SkinTensors(
            data=memory.populations,
            offsets=self._cells.offsets[parity],
            first_cell=self._cells.first_cell,
            lattice=self._lattice,
            params=memory.flow.params.bodies,
            bodies=memory.flow.bodies,
            before=self._skins[parity],
            after=self._skins[1 - parity],
        )

    def _make_slots(self, tensors: SkinTensors) -> Slots:
        """Return the outgoing populations; the corner of a flow's ring is scrap."""
        return Slots(
            data=tensors.data,
            offsets=tensors.offsets,
            first=tensors.first_cell,
            row_length=self._layout.row_length,
            scrap=tensors.first_cell - self._layout.first_cell + tensors.offsets[0],
            lattice=tensors.lattice,
            storage=self._config.storage,
        )


class LocateSkin(_SkinPart):
    """Find where the skins are after the bodies have moved."""

    def act(self, tensors: SkinTensors) -> None:
        """Write them."""
        copy_tree(tensors.after, locate_skin(self._config, tensors.params, tensors.bodies))


class BounceOffBodies(_SkinPart):
    """Reflect populations at the skins, and move the bodies."""

    def act(self, tensors: SkinTensors) -> None:
        """Act as the readable step does."""
        slots, params, bodies = self._make_slots(tensors), tensors.params, tensors.bodies
        skin = tensors.before
        moved = bounce_off_bodies_(self._config, params, bodies, skin, slots, torch.float32)
        copy_tree(bodies, moved)


class UncoverNodes(_SkinPart):
    """Fill the nodes that the skins have passed."""

    def act(self, tensors: SkinTensors) -> None:
        """Act as the readable step does."""
        slots = self._make_slots(tensors)
        uncover_nodes_(self._config, tensors.bodies, tensors.before, tensors.after, slots)
