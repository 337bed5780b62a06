"""The bodies' parts of the fast step, by the kind of skin."""

from collections.abc import Callable
from functools import singledispatch
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.collision import Collided, compute_force_increment, compute_macroscopic
from fishrl.physics.fast.flow_memory import FlowData, GroupMemory
from fishrl.physics.fast.inductor import GATHERING
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.fast.part import Part, copy_tree
from fishrl.physics.flow import FlowConfig
from fishrl.physics.skins.bounce_back import (
    BounceBack,
    Contact,
    find_contact,
    pass_nodes_,
    reflect_,
)
from fishrl.physics.skins.immersed_boundary import (
    BodyGeometry,
    ImmersedBoundary,
    couple_bodies,
    locate_bodies,
)
from fishrl.physics.skins.links import make_families
from fishrl.physics.skins.skin import Skin
from fishrl.physics.skins.slots import Slots, make_offsets

Tree = TypeVar("Tree", bound=tuple[object, ...])
Bodies = tuple[tuple[BodyParams, ...], tuple[BodyState, ...]]
BODY_SETTINGS: dict[str, dict[str, object]] = {
    # The part is small and scatters: one thread, and weights are kept, not computed again for every
    # pair of markers (six times slower at L = 100). Indices are clamped to the grid: no check.
    "cpu": GATHERING
    | {
        "cpp.threads": 1,
        "realize_opcount_threshold": 10,
        "assert_indirect_indexing": False,
    },
    # On a GPU launches count: Inductor puts kernels that do not depend on each other into one. Sums
    # over markers loop, since registers would not hold all terms.
    "cuda": {"combo_kernels": True, "triton.persistent_reductions": False},
}
# Vectors are worth their compilation (another 8 s) from this number of markers on.
_MANY_MARKERS = 50


class SkinParts(NamedTuple):
    """The parts of a skin: one that runs once before many steps, and those of each step."""

    start: Part | None
    step: list[Part]


@singledispatch
def make_skin_parts(
    skin: Skin, config: FlowConfig, layout: InPlaceLayout, sample: FlowData
) -> SkinParts:
    """Return the parts of a skin, for flows with the ``sample``'s numbers.

    They run between collision and edges, on outgoing populations. By default the whole field passes
    through ``skin.exchange``, eagerly; a kind of skin may register parts that compile and visit the
    nodes near a body alone: ``@make_skin_parts.register``.
    """
    kinds, rates = config.bodies, config.rates

    def collect(memory: GroupMemory, parity: int) -> tuple[list[Tensor], Tensor, Bodies]:
        omega = memory.omega[..., None]
        omega = layout.strip_rings(memory.omega) if config.sponges else omega
        return memory.outgoing(parity), omega, get_bodies(memory)

    def act(f: list[Tensor], omega: Tensor, bodies: Bodies) -> None:
        outgoing = [values.clone() for values in f]
        force = torch.zeros_like(torch.stack(outgoing[:2], 1))
        water = Collided(outgoing, compute_macroscopic(outgoing), force, omega, rates)
        changed, moved = skin.exchange(water, kinds, *bodies)
        copy_tree(f, changed)
        copy_tree(bodies[1], moved)

    return SkinParts(None, [Part("exchange", collect, act, None)])


@make_skin_parts.register
def _make_bounce_back(
    skin: BounceBack, config: FlowConfig, layout: InPlaceLayout, sample: FlowData
) -> SkinParts:
    """Find the contact first; then reflect populations, find the new contact, uncover nodes.

    Their tensors are the populations, the bodies, the contact before and after a step.
    """
    device, kinds, size = sample.clock.device, config.bodies, (config.width, config.height)
    find_slots = make_finder(layout, device)
    bodies = sample.params.bodies, sample.bodies
    # before even and before odd steps; bodies that never move have one for both
    even = keep(find_contact(kinds, *bodies, size, make_families(device), torch.float32))
    contacts = even, even if config.is_still else keep(even)

    def collect(memory: GroupMemory, parity: int) -> tuple[Slots, Bodies, Contact, Contact]:
        slots = find_slots(memory, parity)
        return slots, get_bodies(memory), contacts[parity], contacts[1 - parity]

    def locate(slots: Slots, bodies: Bodies, before: Contact, after: Contact) -> None:
        contact = find_contact(kinds, *bodies, slots.size, slots.families, slots.data.dtype)
        copy_tree(after, contact)

    def reflect(slots: Slots, bodies: Bodies, before: Contact, after: Contact) -> None:
        copy_tree(bodies[1], reflect_(kinds, *bodies, before, slots))

    def uncover(slots: Slots, bodies: Bodies, before: Contact, after: Contact) -> None:
        passed = pass_nodes_(kinds, bodies[1], before, after, slots)
        for body, state in zip(bodies[1], passed, strict=True):
            body.surplus.copy_(state.surplus)
            body.slip_impulse.copy_(state.slip_impulse)

    # what all four families of links read is kept: contact 3 us instead of 8 with one fish
    settings = BODY_SETTINGS | {"cpu": BODY_SETTINGS["cpu"] | {"realize_opcount_threshold": 6}}
    contact = Part("contact", collect, locate, settings, any_grid=True)
    reflection = Part("reflection", collect, reflect, settings, any_grid=True)
    uncovering = Part("uncovering", collect, uncover, BODY_SETTINGS, any_grid=True)
    moving = [] if config.is_still else [contact, uncovering]
    return SkinParts(contact, [reflection, *moving])


@make_skin_parts.register
def _make_immersed_boundary(
    skin: ImmersedBoundary, config: FlowConfig, layout: InPlaceLayout, sample: FlowData
) -> SkinParts:
    """Let bodies read the fluid, move, and put their force into it.

    Tensors of the part: the populations; omega ``[B, 1]`` or ``[B, cells]``; the force (x, y)
    ``[cells]``, zero between steps, which all groups share; the bodies; and their geometry if they
    stay still, located once. Others are located in each step.
    """
    device, kinds, size = sample.clock.device, config.bodies, (config.width, config.height)
    find_slots, origin = make_finder(layout, device), layout.first_cell
    force = [torch.zeros(layout.num_cells, device=device) for _ in range(2)]
    rates, has_field = config.rates, bool(config.sponges)

    def locate(bodies: Bodies) -> BodyGeometry:
        return locate_bodies(skin, kinds, *bodies, size, torch.float32)

    kept = keep(locate((sample.params.bodies, sample.bodies))) if config.is_still else ()

    def collect(
        memory: GroupMemory, parity: int
    ) -> tuple[Slots, Tensor, list[Tensor], Bodies, BodyGeometry | tuple[()]]:
        return find_slots(memory, parity), memory.omega, force, get_bodies(memory), kept

    def act(
        slots: Slots,
        omega: Tensor,
        force: list[Tensor],
        bodies: Bodies,
        geometry: BodyGeometry | tuple[()],
    ) -> None:
        """Couple as in ``ImmersedBoundary.exchange``, at the marker nodes alone."""
        geometry = geometry or locate(bodies)
        own = geometry.stencil.index_nodes(slots.nodes.stride(1))
        nodes = own + slots.first[:, None, None]
        leaving = [nodes + offset for offset in slots.offsets.leaving.unbind()]
        fluid = compute_macroscopic([slots.data[places] for places in leaving])
        moved, *shares = couple_bodies(skin, kinds, *bodies, geometry, fluid)
        for total, share in zip(force, shares, strict=True):
            total.index_put_((nodes,), share, accumulate=True)
        if has_field:  # each node has its own
            relaxation = omega.gather(1, (own + origin).flatten(1)).view_as(own)
        else:
            relaxation = omega[..., None]
        whole, part = (force[0][nodes], force[1][nodes]), (shares[0], shares[1])
        increment = compute_force_increment(fluid, whole, relaxation, rates, share=part)
        for places, values in zip(leaving, increment, strict=True):
            slots.data.index_put_((places,), values, accumulate=True)
        for total in force:
            total.index_put_((nodes,), torch.zeros_like(fluid.drho))
        copy_tree(bodies[1], moved)

    settings = BODY_SETTINGS
    if sum(body.num_markers for body in kinds) < _MANY_MARKERS:
        settings = settings | {"cpu": settings["cpu"] | {"cpp.simdlen": 1}}
    coupling = Part("coupling", collect, act, settings)
    if not kept:
        return SkinParts(None, [coupling])

    def collect_still(memory: GroupMemory, parity: int) -> tuple[Bodies, BodyGeometry]:
        return get_bodies(memory), kept

    def start(bodies: Bodies, geometry: BodyGeometry) -> None:
        copy_tree(geometry, locate(bodies))

    return SkinParts(Part("location", collect_still, start, BODY_SETTINGS), [coupling])


def get_bodies(memory: GroupMemory) -> Bodies:
    """Return parameters and states of a group's bodies."""
    return memory.flow.params.bodies, memory.flow.bodies


def make_finder(layout: InPlaceLayout, device: torch.device) -> Callable[[GroupMemory, int], Slots]:
    """Return what finds the outgoing populations of a group, at even or odd steps."""
    first = torch.arange(layout.num_envs, device=device) * layout.flow_length + layout.first_cell
    families = make_families(device)
    offsets = [
        make_offsets(layout.offsets(parity, True), layout.offsets(1 - parity, False), device)
        for parity in (0, 1)
    ]

    def find(memory: GroupMemory, parity: int) -> Slots:
        corner = first - layout.first_cell + offsets[parity].leaving[0]  # of a flow's ring
        nodes = memory.outgoing(parity)[0]
        return Slots(nodes, memory.populations, offsets[parity], first, corner, families)

    return find


def keep(tree: Tree) -> Tree:
    """Return memory for tensors like those of a tree, with their content."""
    kept: Tree = pytree.tree_map(lambda t: t.clone(), tree)
    return kept
