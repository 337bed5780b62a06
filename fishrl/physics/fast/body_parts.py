"""The bodies' parts of the fast step, as tensor operations on any device."""

from collections.abc import Callable
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
    locate_skins,
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
Bodies = tuple[tuple[BodyParams, ...], tuple[BodyState, ...]]
#: Populations of a group, ``[Q]`` int64 offsets of the slots of each outgoing population,
#: and ``[B]`` int64 cells of each flow's node (0, 0).
Places = tuple[Tensor, Tensor, Tensor]
Skins = tuple[Skin, ...]


class Grid(NamedTuple):
    """A group's outgoing populations; code for any grid has its sizes from here."""

    nodes: Tensor  #: ``[B, Y, X]`` the first of them
    lattice: Tensor  #: as ``Slots`` holds it
    data: Tensor  #: as ``Places``
    offsets: Tensor  #: as ``Places``
    first: Tensor  #: as ``Places``

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in nodes."""
        return self.nodes.shape[2], self.nodes.shape[1]

    def list_slots(self) -> Slots:
        """Return all of them; the corner of a flow's ring is scrap."""
        row_length = self.nodes.stride(1)
        return Slots(
            data=self.data,
            offsets=self.offsets,
            first=self.first,
            row_length=row_length,
            scrap=self.first - (row_length + 1) + self.offsets[0],
            lattice=self.lattice,
        )


BODY_SETTINGS: dict[str, dict[str, object]] = {
    # The part is small and scatters: one thread, and weights are kept, not computed again for every
    # pair of markers (six times slower at L = 100).
    "cpu": {"cpp.threads": 1, "realize_opcount_threshold": 10},
    # On a GPU launches count: Inductor puts kernels that do not depend on each other into one. Sums
    # over markers loop, since registers would not hold all terms.
    "cuda": {"combo_kernels": True, "triton.persistent_reductions": False},
}
# Vectors are worth their compilation (another 8 s) from this number of markers on.
_MANY_MARKERS = 50


def get_bodies(memory: GroupMemory) -> Bodies:
    """Return parameters and states of a group's bodies."""
    return memory.flow.params.bodies, memory.flow.bodies


def find_places(
    layout: InPlaceLayout, device: torch.device
) -> Callable[[GroupMemory, int], Places]:
    """Return what finds the outgoing populations of a group, at even or odd steps."""
    flows = torch.arange(layout.num_envs, device=device)
    first_cell = flows * layout.flow_length + layout.first_cell
    offsets = [torch.tensor(layout.offsets(parity, True), device=device) for parity in (0, 1)]
    return lambda memory, parity: (memory.populations, offsets[parity], first_cell)


def keep(tree: Tree) -> Tree:
    """Return memory for tensors like those of a tree, with their content."""
    kept: Tree = pytree.tree_map(lambda t: t.clone(memory_format=torch.contiguous_format), tree)
    return kept


def keep_geometry(config: FlowConfig, sample: FlowData) -> BodyGeometry:
    """Return memory for a geometry of the bodies, with the ``sample``'s content."""
    return keep(locate_bodies(config, sample.params.bodies, sample.bodies, torch.float32))


def make_location(config: FlowConfig, geometry: BodyGeometry) -> Part:
    """Return the part that locates bodies that never move, once before many steps."""

    def collect(memory: GroupMemory, parity: int) -> tuple[Bodies, BodyGeometry]:
        return get_bodies(memory), geometry

    def act(bodies: Bodies, geometry: BodyGeometry) -> None:
        copy_tree(geometry, locate_bodies(config, *bodies, torch.float32))

    return Part("location", collect, act, BODY_SETTINGS)


def make_coupling(
    config: FlowConfig, layout: InPlaceLayout, geometry: BodyGeometry | None, device: torch.device
) -> Part:
    """Return the part that lets bodies read the fluid, move, and put their force into it.

    Its tensors are the populations; omega ``[B, 1]`` or ``[B, cells]``; the force (x, y)
    ``[cells]``, zero between steps, which all groups share; the bodies; and their ``geometry`` if
    they stay still. Others are located in each step.
    """
    places, row_length, origin = find_places(layout, device), layout.row_length, layout.first_cell
    force = [torch.zeros(layout.num_cells, device=device) for _ in range(2)]

    def collect(
        memory: GroupMemory, parity: int
    ) -> tuple[Places, Tensor, list[Tensor], Bodies, BodyGeometry | tuple[()]]:
        return places(memory, parity), memory.omega, force, get_bodies(memory), geometry or ()

    def act(
        places: Places,
        omega: Tensor,
        force: list[Tensor],
        bodies: Bodies,
        geometry: BodyGeometry | tuple[()],
    ) -> None:
        """Couple as in ``step.couple_bodies``, at the marker nodes alone."""
        data, offsets, first_cell = places
        geometry = geometry or locate_bodies(config, *bodies, torch.float32)
        own = geometry.stencil.index_nodes(row_length)
        nodes = own + first_cell[:, None, None]
        slots = [nodes + offsets[q] for q in range(Q)]
        fluid = compute_macroscopic([data[slot] for slot in slots])
        moved, *shares = couple_bodies(config, *bodies, geometry, fluid)
        for total, share in zip(force, shares, strict=True):
            total.index_put_((nodes,), share, accumulate=True)
        if config.sponges:  # each node has its own
            rates = omega.gather(1, (own + origin).flatten(1)).view_as(own)
        else:
            rates = omega[..., None]
        whole, part = (force[0][nodes], force[1][nodes]), (shares[0], shares[1])
        increment = compute_force_increment(fluid, whole, rates, config.rates, share=part)
        for slot, values in zip(slots, increment, strict=True):
            data.index_put_((slot,), values, accumulate=True)
        for total in force:
            total.index_put_((nodes,), torch.zeros_like(fluid.drho))
        copy_tree(bodies[1], moved)

    settings = BODY_SETTINGS
    if sum(body.num_markers for body in config.bodies) < _MANY_MARKERS:
        settings = settings | {"cpu": settings["cpu"] | {"cpp.simdlen": 1}}
    return Part("coupling", collect, act, settings)


def make_skin_parts(
    config: FlowConfig, layout: InPlaceLayout, sample: FlowData
) -> tuple[Part, list[Part]]:
    """Return the parts of bodies with sharp skins, with the ``sample``'s sizes.

    The first finds all skins, once before many steps. Those of each step reflect populations at
    the skins and move the bodies, find the skins that have moved, and fill the nodes that they have
    passed. Their tensors are the grid, the bodies, their skins before and after a step.
    """
    device, kinds = sample.clock.device, config.bodies
    places, lattice = find_places(layout, device), make_lattice(device)
    size = config.width, config.height
    # before even and before odd steps
    skins = [keep(locate_skins(kinds, sample.params.bodies, sample.bodies, size)) for _ in range(2)]
    # bodies that never move have one for both
    skins[1] = tuple(
        first if body.is_still else second
        for body, first, second in zip(kinds, *skins, strict=True)
    )

    def collect(memory: GroupMemory, parity: int) -> tuple[Grid, Bodies, Skins, Skins]:
        before, after = skins[parity], skins[1 - parity]
        grid = Grid(memory.outgoing(parity)[0], lattice, *places(memory, parity))
        return grid, get_bodies(memory), before, after

    def locate(grid: Grid, bodies: Bodies, before: Skins, after: Skins) -> None:
        copy_tree(after, locate_skins(kinds, *bodies, grid.size))

    def follow(grid: Grid, bodies: Bodies, before: Skins, after: Skins) -> None:
        copy_tree(after, locate_skins(kinds, *bodies, grid.size, before))

    def reflect(grid: Grid, bodies: Bodies, before: Skins, after: Skins) -> None:
        slots = grid.list_slots()
        copy_tree(bodies[1], bounce_off_bodies_(kinds, *bodies, before, slots, torch.float32))

    def uncover(grid: Grid, bodies: Bodies, before: Skins, after: Skins) -> None:
        uncover_nodes_(kinds, bodies[1], before, after, grid.list_slots())

    # stacked arrays are written at once: each of their parts would be a tensor made in every call
    settings = BODY_SETTINGS | {"cpu": BODY_SETTINGS["cpu"] | {"force_pointwise_cat": True}}
    start = moved = Part("skin", collect, locate, settings, any_grid=True)
    reflection = Part("reflection", collect, reflect, BODY_SETTINGS, any_grid=True)
    if config.is_still:
        return start, [reflection]
    if any(body.is_still for body in kinds):
        moved = Part("moved skin", collect, follow, settings, any_grid=True)
    uncovering = Part("uncovering", collect, uncover, BODY_SETTINGS, any_grid=True)
    return start, [reflection, moved, uncovering]
