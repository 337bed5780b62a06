"""Interpolated bounce-back: a body's skin as a sharp surface. ``step.py`` has the equations.

Nodes inside a body collide and stream as all others, but nothing outside reads them.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.collision import Collided
from fishrl.physics.geometry import Outline, locate_outline
from fishrl.physics.lattice import Q, W
from fishrl.physics.rigid_motion import measure_gain, move_body, report_body
from fishrl.physics.skins.links import (
    MARGIN,
    MAX_SPACING,
    Links,
    find_links,
    find_passed,
    to_links,
    to_markers,
)
from fishrl.physics.skins.skin import Body, Skin
from fishrl.physics.skins.slots import Slots, copy_slots
from fishrl.physics.surface import eliminate, prescribe_surface

#: Part of a body's ``surplus`` and ``slip_impulse`` that is given back in a step: fast enough to
#: keep the pressure, slow enough that single nodes do not shake the body.
RETURN_RATE = 0.1


class BounceBack(Skin):
    """A sharp skin: populations that meet it return to the node they came from.

    More accurate for a thin fish than an immersed boundary, and stable for a body of any density.
    """

    marker_spacing: ClassVar[float] = 0.5
    spacing_range: ClassVar[tuple[float, float]] = (0.1, MAX_SPACING)
    margin: ClassVar[float] = MARGIN
    jumps: ClassVar[bool] = True
    has_water_inside: ClassVar[bool] = False

    def exchange(
        self,
        water: Collided,
        bodies: Sequence[BodyConfig],
        params: Sequence[BodyParams],
        states: Sequence[BodyState],
    ) -> tuple[list[Tensor], tuple[BodyState, ...]]:
        """Reflect what meets the skins, move the bodies, and fill the nodes that they leave."""
        height, width = water.f[0].shape[-2:]
        slots = copy_slots(water.add_force(water.force))
        before = find_contacts(bodies, params, states, (width, height))
        states = reflect_(bodies, params, states, before, slots)
        after = find_contacts(bodies, params, states, (width, height), before)
        states = pass_nodes_(bodies, states, before, after, slots, (width, height))
        return slots.get_nodes(water.f[0]), states

    def fit(self, body: Body) -> Body:
        """Refuse markers that do not lie on the skin, in addition."""
        fitted = super().fit(body)
        if fitted.inset:
            raise ValueError(
                f"{type(body).__name__} with inset = {body.inset}: must be 0 with skin = "
                "BounceBack(), which lies at the markers; leave out inset"
            )
        return fitted


class Contact(NamedTuple):
    """Where the skin of one body meets the lattice."""

    outline: Outline  #: where the body is
    links: Links  #: links that its outline cuts


def find_contacts(
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    size: tuple[int, int],
    last: Sequence[Contact] | None = None,
) -> tuple[Contact, ...]:
    """Deform and place each body, and find the links that its outline cuts.

    The grid has a ``size`` of (width, height) nodes. With the contacts of the ``last`` step, bodies
    that never move keep theirs.
    """
    contacts = []
    for m, (body, own, state) in enumerate(zip(bodies, params, states, strict=True)):
        if last is not None and body.is_still:
            contacts.append(last[m])
        else:
            outline = locate_outline(body, own, state)
            contacts.append(Contact(outline, find_links(outline.markers.position, *size)))
    return tuple(contacts)


def reflect_(
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    contacts: Sequence[Contact],
    slots: Slots,
) -> tuple[BodyState, ...]:
    """Reflect outgoing populations at the skin of all bodies, in place, and move the bodies.

    What returns from a body replaces what leaves the nodes inside it, which is not read.

    Returns:
        The bodies one step later.
    """
    each = zip(bodies, params, states, contacts, strict=True)
    return tuple(_reflect_one_(*body, slots) for body in each)


def _reflect_one_(
    body: BodyConfig, params: BodyParams, state: BodyState, contact: Contact, slots: Slots
) -> BodyState:
    outline, links = contact
    dtype = slots.data.dtype
    cx, cy, is_cut = (part.to(dtype) for part in (links.cx, links.cy, links.is_cut))

    # What arrives at the skin, and what returns from one at rest; zero where no link is cut.
    arriving = slots.read(links.x, links.y, links.q)
    behind = slots.read(links.x - links.cx, links.y - links.cy, links.q)
    leaving = slots.read(links.x, links.y, links.back)
    twice = 2.0 * links.fraction.to(dtype)
    inverse = 1.0 / twice.clamp_min(1.0)
    far = (arriving + (twice - 1.0) * leaving) * inverse
    near = twice * arriving + (1.0 - twice) * behind
    arriving, still = is_cut * arriving, is_cut * torch.where(twice < 1.0, near, far)
    six_w = is_cut * ((links.q < 5).to(dtype) * (6.0 * (W[1] - W[5])) + 6.0 * W[5])
    q = torch.arange(Q, device=six_w.device)[:, None, None]
    rho = 1.0 + slots.read(links.x[:, None], links.y[:, None], q).sum(1)
    gain = six_w * rho * inverse  # what returns less per velocity of the skin along the link
    # the surplus leaves evenly along the skin
    leak = RETURN_RATE * state.surplus.to(dtype) / six_w.sum((1, 2)).clamp_min(1e-6)
    still = still - leak[:, None, None] * six_w
    felt = RETURN_RATE * state.slip_impulse

    def reflect(ux: Tensor, uy: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return what comes back from a skin of velocity ``[B, 4, N]``, and the force on it."""
        returning = still - gain * (cx * ux + cy * uy)
        both, lost = arriving + returning, arriving - returning
        return returning, cx * both - ux * lost, cy * both - uy * lost

    # Newton's second law gives the rates that the flow determines: the force is linear in them.
    surface = prescribe_surface(body, params, state, outline, dtype, has_water_inside=False)
    velocity = [to_links(u, links) for u in surface.velocity.unbind(1)]
    changes: list[Tensor] = []
    if surface.freedoms:
        _, *force = reflect(*velocity)
        fx, fy = (to_markers(part, links) for part in force)
        along, drive = [], []
        for free in surface.freedoms:
            units = [
                (c, f, u)
                for c, f, u in zip((cx, cy), (fx, fy), free.unit, strict=True)
                if u is not None
            ]
            along.append(sum(c * to_links(u, links) for c, _, u in units))
            push = free.push + felt[:, free.axis]
            drive.append(sum((f * u).sum(-1).double() for _, f, u in units) + push)
        matrix = [
            [(gain * a * b).sum((1, 2)).double() + (free.inertia if a is b else 0.0) for b in along]
            for a, free in zip(along, surface.freedoms, strict=True)
        ]
        changes = eliminate(matrix, drive)
    for free, change in zip(surface.freedoms, changes, strict=True):
        for axis, unit in enumerate(free.unit):
            if unit is not None:
                weight = change.to(dtype)[:, None, None]
                velocity[axis] = velocity[axis] + weight * to_links(unit, links)

    # What returns streams back to the nodes outside, from the slots of those inside.
    returning, *force = reflect(*velocity)
    slots.write_(links.x + links.cx, links.y + links.cy, links.back, returning, links.is_cut)
    fx, fy = (-to_markers(part, links) for part in force)
    rates = surface.change_rates(changes)
    update = report_body(state, outline, rates, force=(fx, fy), slip=None)
    # totals count the water inside, too: as if it filled the body and moved with it
    momentum, spin_up = measure_gain(params, state, outline.deformation, update)
    update = update._replace(
        force=update.force + momentum - felt[:, :2], torque=update.torque + spin_up - felt[:, 2]
    )
    moved = move_body(body, params, state, outline.deformation, update)
    return moved._replace(
        surplus=state.surplus + (returning - arriving).sum((1, 2)).double(),
        slip_impulse=state.slip_impulse - felt,
    )


def pass_nodes_(
    bodies: Sequence[BodyConfig],
    states: Sequence[BodyState],
    before: Sequence[Contact],
    after: Sequence[Contact],
    slots: Slots,
    size: tuple[int, int],
) -> tuple[BodyState, ...]:
    """Fill the nodes that the bodies have left in the step just made, in place.

    Args:
        bodies: configuration of each body.
        states: state of each body after the step.
        before: where the skins were.
        after: where they are.
        slots: outgoing populations of the step; those that arrive at the uncovered nodes are set.
        size: width and height of the grid in nodes.

    Returns:
        The bodies: mass of the nodes that changed sides is in their surplus, momentum with which
        covered ones slipped past in their slip impulse.
    """
    each = zip(bodies, states, before, after, strict=True)
    return tuple(
        state if body.is_still else _pass_nodes_of_one_(state, former, contact, slots, size)
        for body, state, former, contact in each
    )


def _pass_nodes_of_one_(
    state: BodyState, before: Contact, after: Contact, slots: Slots, size: tuple[int, int]
) -> BodyState:
    markers = after.outline.markers
    passed = find_passed(before.outline.markers.position, markers.position, *size)
    # populations ``[B, Q, N]`` that arrive at a covered node, and at the next one outside
    cx, cy, w = (part[:, None] for part in slots.lattice.unbind(1))
    x, y = passed.x[:, None] - cx.long(), passed.y[:, None] - cy.long()
    q = torch.arange(Q, device=cx.device)[:, None]
    f = slots.read(x + passed.cx[:, None], y + passed.cy[:, None], q)
    drho = f.sum(1, keepdim=True)
    # the skin's velocity in place of the next node's
    spin = torch.stack((-markers.arm[..., 1], markers.arm[..., 0]), -1)
    rigid = state.velocity[:, None] + state.angular_velocity[:, None, None] * spin
    skin = rigid + markers.deformation_velocity
    skin = skin + passed.at[..., None] * (torch.cat((skin[:, 1:], skin[:, :1]), 1) - skin)
    cx, cy, w, rho = cx.to(f), cy.to(f), w.to(f), 1.0 + drho
    speed = (f * cx).sum(1, keepdim=True) / rho, (f * cy).sum(1, keepdim=True) / rho
    ux, uy = (part.to(f)[:, None] for part in skin.unbind(-1))
    change = _expand(cx, cy, ux, uy) - _expand(cx, cy, *speed)
    slots.write_(x, y, q, f + w * rho * change, passed.turns[:, None] < 0)
    covered = rho[:, 0] * passed.turns.clamp(min=0)
    px, py = (covered * (fluid - own)[:, 0] for fluid, own in zip(speed, (ux, uy), strict=True))
    rx, ry = passed.x - state.position[:, :1], passed.y - state.position[:, 1:]
    slip = torch.stack([part.sum(-1).double() for part in (px, py, rx * py - ry * px)], -1)
    return state._replace(
        surplus=state.surplus - (passed.turns * drho[:, 0]).sum(-1).double(),
        slip_impulse=state.slip_impulse + slip,
    )


def _expand(cx: Tensor, cy: Tensor, ux: Tensor, uy: Tensor) -> Tensor:
    """Return f_eq / (w rho) - 1."""
    along = cx * ux + cy * uy
    return 3.0 * along + 4.5 * along * along - 1.5 * (ux * ux + uy * uy)
