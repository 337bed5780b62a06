"""The kernels of the fast step: functions of tensors alone that change their arguments in place."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.boundaries import Boundary, Side
from fishrl.physics.collision import (
    collide_mrt,
    compute_force_increment,
    compute_macroscopic,
    compute_moments,
)
from fishrl.physics.fast.compiled import Kernel
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.flow import FlowConfig, FlowParams, compute_stream_speed
from fishrl.physics.geometry import BodyGeometry, locate_bodies
from fishrl.physics.lattice import OPPOSITE, Q
from fishrl.physics.step import exchange
from fishrl.physics.storage import Storage

# A flow whose speed passes this (Mach 0.87), or whose density differs from that at rest by all of
# it, is beyond the method and counts as diverged.
MAX_SPEED = 0.5


class Exchange(NamedTuple):
    """What the kernel for a GPU is given and returns; see ``body_kernel.couple_bodies``."""

    surface: Tensor
    inertia: Tensor
    push: Tensor
    g: Tensor
    slip: Tensor
    mass: Tensor
    change: Tensor
    steps: Tensor


class BodyArguments(NamedTuple):
    """What the bodies' part of a step reads and writes.

    ``offsets`` ``[Q]`` are those of the outgoing populations' slots, ``first_cell`` ``[B]`` is the
    cell of each flow's node (0, 0), ``omega`` ``[B, 1]`` or ``[B, cells]``. Tensor operations need
    ``force`` (x, y) ``[cells]``, which is zero between steps, and keep the ``geometry`` of bodies
    that stay still; the kernel for a GPU needs ``exchange`` and keeps any geometry. What is not
    needed is empty.
    """

    data: Tensor
    force: tuple[Tensor, ...]
    offsets: Tensor
    first_cell: Tensor
    omega: Tensor
    bodies: tuple[BodyState, ...]
    params: tuple[BodyParams, ...]
    geometry: BodyGeometry | tuple[()]
    exchange: Exchange | tuple[()]


def make_collide(config: FlowConfig) -> Kernel:
    """Return: collide without force; on the incoming views this streams as well."""
    storage = config.storage

    def collide(clock: Tensor, omega: Tensor, *f: Tensor) -> None:
        clock.add_(1.0)
        decoded = [storage.decode(g) for g in f]
        for q, g in enumerate(collide_mrt(decoded, omega, config.rates)):
            f[OPPOSITE[q]].copy_(storage.encode(g))

    return collide


def copy_tree(old: object, new: object) -> None:
    """Copy tensors into those of a structure of the same form."""
    for a, b in zip(pytree.tree_leaves(old), pytree.tree_leaves(new), strict=True):
        a.copy_(b)


def make_locate(config: FlowConfig, form: pytree.TreeSpec) -> Kernel:
    """Return: place markers and stencils of bodies that stay where they are."""

    def locate(*leaves: Tensor) -> None:
        call: BodyArguments = pytree.tree_unflatten(leaves, form)
        copy_tree(call.geometry, locate_bodies(config, call.params, call.bodies, torch.float32))

    return locate


def make_bodies(config: FlowConfig, layout: InPlaceLayout, form: pytree.TreeSpec) -> Kernel:
    """Return: the bodies read the fluid, move, and put their force into the populations."""
    storage = config.storage

    def act(*leaves: Tensor) -> None:
        call: BodyArguments = pytree.tree_unflatten(leaves, form)
        data, (force_x, force_y) = call.data, call.force
        # bodies that stay still were located before
        geometry = call.geometry or locate_bodies(config, call.params, call.bodies, torch.float32)
        nodes = geometry.stencil.index_nodes(layout.row_length) + call.first_cell[:, None, None]
        slots = [nodes + call.offsets[q] for q in range(Q)]
        fluid = compute_macroscopic([storage.decode(data[slot]) for slot in slots])
        moved, share_x, share_y = exchange(config, call.params, call.bodies, geometry, fluid)
        force_x.index_put_((nodes,), share_x, accumulate=True)
        force_y.index_put_((nodes,), share_y, accumulate=True)
        omega = call.omega[..., None]
        if config.sponges:  # each node has its own
            omega = layout.strip_rings(call.omega).flatten(1)
            own = geometry.stencil.index_nodes(config.width)
            omega = omega.gather(1, own.flatten(1)).view_as(own)
        force, share = (force_x[nodes], force_y[nodes]), (share_x, share_y)
        increment = compute_force_increment(fluid, force, share, omega, config.rates)
        for slot, values in zip(slots, increment, strict=True):
            data.index_put_((slot,), storage.encode(values), accumulate=True)
        for total in (force_x, force_y):
            total.index_put_((nodes,), torch.zeros_like(fluid.drho))
        copy_tree(call.bodies, moved)

    return act


def make_check(config: FlowConfig) -> Kernel:
    """Return: look at every node of the flows."""
    storage = config.storage

    def check(is_fine: Tensor, *f: Tensor) -> None:
        drho, jx, jy = compute_moments([storage.decode(g) for g in f])
        limit = MAX_SPEED * (drho + 1.0)
        # comparisons with NaN are false, so a broken flow is never fine
        is_node_fine = (jx * jx + jy * jy < limit * limit) & (drho.abs() < 1.0)
        is_fine.copy_(is_node_fine.flatten(1).all(-1))

    return check


def make_edges(sides: list[tuple[Side, Boundary]], storage: Storage) -> Kernel:
    """Return: set some edges.

    After the clock and the flows' numbers come the profiles, and of each side 9 x 3 views: edge,
    neighbour, outgoing.
    """
    num_numbers = len(FlowParams._fields) - 1  # all but the bodies

    def set_edges(clock: Tensor, *rest: Tensor) -> None:
        params, rest = FlowParams._make((*rest[:num_numbers], ())), rest[num_numbers:]
        speed_now = compute_stream_speed(params, clock).float()[:, None]
        profiles, views = rest[: len(sides)], rest[len(sides) :]
        for i, (side, boundary) in enumerate(sides):
            edge, *known = (views[(3 * i + j) * Q :][:Q] for j in range(3))
            neighbour, outgoing = ([storage.decode(f) for f in views] for views in known)
            speed = speed_now * profiles[i]
            for q, values in boundary.compute_edge(side, neighbour, outgoing, speed).items():
                edge[q].copy_(storage.encode(values))

    return set_edges
