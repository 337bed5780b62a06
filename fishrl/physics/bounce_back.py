"""Interpolated bounce-back: a body's skin as a sharp surface.

The immersed boundary spreads a force over three nodes, so that the water on both sides of a thin
fish feels each other's, and the boundary layer begins inside the kernel. Here the populations that
meet the skin between two nodes return to the node they came from, with what the moving skin adds.
With q the part of the link c_i from a node x outside to the skin, u_w the skin's velocity there and
f' the populations after collision (Bouzidi, Firdaouss & Lallemand 2001, eqs. 5 and 11)::

    f_-i(x, t+1) = 2 q f'_i(x) + (1 - 2 q) f'_i(x - c_i) - 6 w_i c_i . u_w             q < 1/2
    f_-i(x, t+1) = (f'_i(x) + (2 q - 1) f'_-i(x) - 6 w_i c_i . u_w) / (2 q)            q >= 1/2

At each link the body feels ``c_i (f'_i + f_-i) - u_w (f'_i - f_-i)`` (Wen et al. 2014). But for
the last u_w this is linear in the body's rates, so those that the flow determines follow from a
system of at most three equations per body, stable for a body as light as water. A node that the
skin has passed takes the skin's velocity, and density and stresses of the next node outside. Nodes
inside a body collide and stream as all others, but nothing outside reads them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.gait import Deformation
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.coupling import eliminate
from fishrl.physics.flow import Coupling
from fishrl.physics.geometry import Markers, Outlines, deform_body, place_markers
from fishrl.physics.lattice import CX, CY, Q, W
from fishrl.physics.links import Links, find_links, to_links, to_markers
from fishrl.physics.rigid_motion import Pair, measure_gain, move_body, report_bodies
from fishrl.physics.surface import Freedom, prescribe_surface, slice_markers


class Slots(NamedTuple):
    """Where the outgoing populations of nodes lie in a flat buffer ``data``."""

    data: Tensor  #: populations after collision; changed in place
    offsets: Tensor  #: ``[Q]`` int64, by direction
    first: Tensor  #: ``[B]`` int64, of each flow's node (0, 0)
    row_length: int  #: from a node to the next along y
    scrap: Tensor  #: ``[B]`` int64, a slot of each flow that nobody reads
    lattice: Tensor  #: ``[Q, 3]`` float64, c_x, c_y and w of each direction

    def read(self, x: Tensor, y: Tensor, q: Tensor) -> Tensor:
        """Return outgoing populations q of nodes (x, y), int64 ``[B, ...]``."""
        return self.data[self._find(x, y, q)]

    def write_(self, x: Tensor, y: Tensor, q: Tensor, values: Tensor, where: Tensor) -> None:
        """Set them ``where`` true."""
        index = torch.where(where, self._find(x, y, q), _widen(self.scrap, x))
        self.data.index_put_((index,), torch.where(where, values, 0.0))

    def get_nodes(self, like: Tensor) -> list[Tensor]:
        """Return all populations, nine ``[B, Y, X]`` shaped like ``like``; of ``list_slots``."""
        return [*self.data[len(like) :].view(len(like), Q, *like.shape[1:]).unbind(1)]

    def _find(self, x: Tensor, y: Tensor, q: Tensor) -> Tensor:
        return _widen(self.first, x) + self.offsets[q] + y * self.row_length + x


def _widen(values: Tensor, like: Tensor) -> Tensor:
    """Return values ``[B]`` as ``[B, 1, ...]``."""
    return values.view(-1, *[1] * (like.dim() - 1))


def make_lattice(device: torch.device) -> Tensor:
    """Return ``Slots.lattice``."""
    return torch.tensor([CX, CY, W], dtype=torch.float64, device=device).T.contiguous()


def list_slots(outgoing: Sequence[Tensor]) -> Slots:
    """Copy nine populations ``[B, Y, X]`` into a buffer; its first B slots are scrap."""
    num, height, width = outgoing[0].shape
    data = torch.cat((outgoing[0].new_zeros(num), torch.stack(list(outgoing), 1).flatten()))
    flow = torch.arange(num, device=data.device)
    return Slots(
        data=data,
        offsets=torch.arange(Q, device=data.device) * (height * width),
        first=num + flow * (Q * height * width),
        row_length=width,
        scrap=flow,
        lattice=make_lattice(data.device),
    )


class _Wall(NamedTuple):
    """What meets a body's skin; ``[B, 4, N]`` each."""

    links: Links  #: links that the skin cuts
    cx: Tensor  #: direction of each link, into the body
    cy: Tensor  #: the same along y
    arriving: Tensor  #: f'_i at the node outside
    still: Tensor  #: what returns from a skin at rest
    #: what returns less per velocity of the skin into the body, 6 w_i or 6 w_i / (2 q)
    gain: Tensor

    def reflect(self, ux: Tensor, uy: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return what comes back from a skin of velocity ``[B, 4, N]``, and the force on it."""
        returning = self.still - self.gain * (self.cx * ux + self.cy * uy)
        both, lost = self.arriving + returning, self.arriving - returning
        return returning, self.cx * both - ux * lost, self.cy * both - uy * lost


class Skin(NamedTuple):
    """Where the skin of one body is."""

    deformation: Deformation  #: how the body deforms
    markers: Markers  #: its outline
    links: Links  #: links that the outline cuts


def locate_skins(
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    size: tuple[int, int],
    last: Sequence[Skin] | None = None,
) -> tuple[Skin, ...]:
    """Deform and place each body, and find the links that its outline cuts.

    The grid has a ``size`` of (width, height) nodes. With the skins of the ``last`` step, bodies
    that never move keep theirs.
    """
    skins = []
    for m, (body, own, state) in enumerate(zip(bodies, params, states, strict=True)):
        if last is not None and body.is_still:
            skins.append(last[m])
        else:
            deformation = deform_body(body, own, state)
            markers = place_markers(state, deformation)
            links = find_links(markers.position, *size)
            skins.append(Skin(deformation, markers, links))
    return tuple(skins)


def bounce_off_bodies_(
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    skins: Sequence[Skin],
    slots: Slots,
    dtype: torch.dtype,
) -> tuple[BodyState, ...]:
    """Reflect outgoing populations at the skin of all bodies, in place, and move the bodies.

    Args:
        bodies: configuration of each body.
        params: parameters of each body.
        states: state of each body at the start of the step.
        skins: where their skins are then.
        slots: populations after collision; what returns from a body replaces what leaves the nodes
            inside it.
        dtype: of the populations.

    Returns:
        The bodies one step later.
    """
    outlines = Outlines(
        tuple(skin.deformation for skin in skins), tuple(skin.markers for skin in skins)
    )
    surface = prescribe_surface(bodies, Coupling.BOUNCE_BACK, params, states, outlines, dtype)
    changes: list[Tensor] = []
    forces: list[Pair] = []
    for skin, own in zip(skins, slice_markers(outlines), strict=True):
        links = skin.links
        wall = _meet(slots, links, dtype)
        velocity = [to_links(u, links) for u in surface.velocity[..., own].unbind(1)]
        freedoms = [_cut(free, own) for free in surface.freedoms if free.body == len(forces)]
        for free, change in zip(freedoms, _solve_motion(wall, freedoms, velocity), strict=True):
            changes.append(change)
            for axis, unit in enumerate(free.unit):
                if unit is not None:
                    weight = change.to(dtype)[:, None, None]
                    velocity[axis] = velocity[axis] + weight * to_links(unit, links)
        returning, force_x, force_y = wall.reflect(*velocity)
        forces.append((-to_markers(force_x, links), -to_markers(force_y, links)))
        slots.write_(links.x + links.cx, links.y + links.cy, links.back, returning, links.is_cut)
    fx, fy = (torch.cat(parts, -1) for parts in zip(*forces, strict=True))
    updates = report_bodies(states, outlines, surface, changes=changes, force=(fx, fy), slip=None)
    moved = []
    each = zip(bodies, params, states, outlines.deformations, updates, strict=True)
    for body, own_params, state, deformation, update in each:
        # the other totals count the water inside: as if it filled the body and moved with it
        gain, spin_up = measure_gain(own_params, state, deformation, update)
        whole = update._replace(force=update.force + gain, torque=update.torque + spin_up)
        moved.append(move_body(body, own_params, state, deformation, whole))
    return tuple(moved)


def uncover_nodes_(
    bodies: Sequence[BodyConfig],
    states: Sequence[BodyState],
    before: Sequence[Skin],
    now: Sequence[Skin],
    slots: Slots,
) -> None:
    """Fill the nodes that the bodies have left in the step just made, in place.

    Args:
        bodies: configuration of each body.
        states: state of each body after the step.
        before: where the skins were.
        now: where they are.
        slots: outgoing populations of the step; those that arrive at the uncovered nodes are set.
    """
    for m, (body, state) in enumerate(zip(bodies, states, strict=True)):
        if not body.is_still:
            former, skin = before[m].markers.position, now[m]
            _uncover_(slots, state, former, skin.markers, skin.links.along_axes())


def _cut(freedom: Freedom, own: slice) -> Freedom:
    """Keep a freedom's own markers of all."""
    x, y = (None if part is None else part[:, own] for part in freedom.unit)
    return freedom._replace(unit=(x, y))


def _meet(slots: Slots, links: Links, dtype: torch.dtype) -> _Wall:
    """Read the populations on both sides of the nodes outside; zero where no link is cut."""
    x, y, cx, cy = links.x, links.y, links.cx, links.cy
    arriving, leaving = slots.read(x, y, links.q), slots.read(x, y, links.back)
    behind = slots.read(x - cx, y - cy, links.q)
    part = 2.0 * links.fraction.to(dtype)
    inverse = 1.0 / part.clamp_min(1.0)
    far = (arriving + (part - 1.0) * leaving) * inverse
    still = torch.where(part < 1.0, part * arriving + (1.0 - part) * behind, far)
    six_w = (links.q < 5).to(dtype) * (6.0 * (W[1] - W[5])) + 6.0 * W[5]
    cut = links.is_cut.to(dtype)
    gain = cut * six_w * inverse
    return _Wall(links, cx.to(dtype), cy.to(dtype), cut * arriving, cut * still, gain)


def _solve_motion(
    wall: _Wall, freedoms: Sequence[Freedom], velocity: Sequence[Tensor]
) -> list[Tensor]:
    """Return the change ``[B]`` of each rate that the flow determines, by Newton's second law."""
    if not freedoms:
        return []
    _, force_x, force_y = wall.reflect(*velocity)
    force = to_markers(force_x, wall.links), to_markers(force_y, wall.links)
    along, drive = [], []
    for free in freedoms:
        pairs = [
            (c, u) for c, u in zip((wall.cx, wall.cy), free.unit, strict=True) if u is not None
        ]
        along.append(sum(c * to_links(u, wall.links) for c, u in pairs))
        parts = [f * u for f, u in zip(force, free.unit, strict=True) if u is not None]
        drive.append(sum(part.sum(-1).double() for part in parts) + free.push)
    matrix = [
        [
            (wall.gain * a * b).sum((1, 2)).double() + (free.inertia if a is b else 0.0)
            for b in along
        ]
        for a, free in zip(along, freedoms, strict=True)
    ]
    return eliminate(matrix, drive)


def _uncover_(
    slots: Slots, state: BodyState, before: Tensor, markers: Markers, links: Links
) -> None:
    """Fill the nodes that one body has left.

    Args:
        slots: as of ``uncover_nodes_``.
        state: state of the body after the step.
        before: ``[B, N, 2]`` positions of the markers before it.
        markers: markers after it.
        links: links along x and y after it; a node that the skin has just passed has one of them.
    """
    tangent = (before.roll(-1, 1) - before)[:, None]
    from_before = torch.stack((links.x, links.y), -1) - before[:, None]
    depth = from_before[..., 0] * tangent[..., 1] - from_before[..., 1] * tangent[..., 0]
    is_new = links.is_cut & (depth > 0.0)  # it was inside
    spin = torch.stack((-markers.arm[..., 1], markers.arm[..., 0]), -1)
    rigid = state.velocity[:, None] + state.angular_velocity[:, None, None] * spin
    skin = rigid + markers.deformation_velocity
    # from here on [B, Q, 2, N]
    cx, cy, w = (part[:, None, None] for part in slots.lattice.unbind(1))
    own_x, own_y = cx.long(), cy.long()
    q = torch.arange(Q, device=cx.device)[:, None, None]
    x, y = links.x[:, None], links.y[:, None]
    next_x, next_y = x - links.cx[:, None] - own_x, y - links.cy[:, None] - own_y
    f = slots.read(next_x, next_y, q)
    cx, cy, w = cx.to(f), cy.to(f), w.to(f)
    rho = 1.0 + f.sum(1, keepdim=True)
    speed = (f * cx).sum(1, keepdim=True) / rho, (f * cy).sum(1, keepdim=True) / rho
    ux, uy = (to_links(part, links).to(f)[:, None] for part in skin.unbind(-1))
    change = _expand(cx, cy, ux, uy) - _expand(cx, cy, *speed)
    # a link after the other: in one write, a node with several would have several values, of which
    # one is kept and all get its gradient
    for k, side in ((0, 1), (0, -1), (1, 1), (1, -1)):
        is_here = is_new[:, k] & ((links.cx + links.cy)[:, k] == side)
        to_x, to_y, values = (
            part[..., k, :] for part in (x - own_x, y - own_y, f + w * rho * change)
        )
        slots.write_(to_x, to_y, q[..., 0], values, is_here[:, None])


def _expand(cx: Tensor, cy: Tensor, ux: Tensor, uy: Tensor) -> Tensor:
    """Return f_eq / (w rho) - 1."""
    along = cx * ux + cy * uy
    return 3.0 * along + 4.5 * along * along - 1.5 * (ux * ux + uy * uy)
