"""Interpolated bounce-back: a body's skin as a sharp surface. ``step.py`` has the equations.

Nodes inside a body collide and stream as all others, but nothing outside reads them.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.collision import (
    Collided,
    compute_equilibrium,
    compute_macroscopic,
    compute_moments,
)
from fishrl.physics.geometry import Outline, compute_velocity, locate_outline
from fishrl.physics.rigid_motion import move_body
from fishrl.physics.skins.links import (
    MARGIN,
    MAX_SPACING,
    Families,
    Links,
    find_links,
    find_passed,
    follow,
    to_links,
    to_markers,
)
from fishrl.physics.skins.skin import Body, Skin
from fishrl.physics.skins.slots import Slots, copy_slots
from fishrl.physics.surface import Surface, eliminate, prescribe_surface

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
        slots = copy_slots(water.add_force(water.force))
        grid = slots.size, slots.families, slots.data.dtype
        before = find_contact(bodies, params, states, *grid)
        states = reflect_(bodies, params, states, before, slots)
        after = find_contact(bodies, params, states, *grid)
        states = pass_nodes_(bodies, states, before, after, slots)
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
    """Where the skins meet the lattice; the markers of the bodies follow each other in N."""

    outlines: tuple[Outline, ...]  #: where the bodies are
    links: Links  #: links that the outlines cut


def find_contact(
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    size: tuple[int, int],
    families: Families,
    dtype: torch.dtype,
) -> Contact:
    """Deform and place each body, and find the links that the outlines cut, of ``dtype``.

    The grid has a ``size`` of (width, height) nodes.
    """
    each = zip(bodies, params, states, strict=True)
    outlines = tuple(locate_outline(*body) for body in each)
    places = torch.cat([outline.markers.position for outline in outlines], 1)
    return Contact(outlines, find_links(places, _count(bodies), size, families, dtype))


class Meeting(NamedTuple):
    """What meets the skins; ``[B, 4, N]`` each, zero where no link is cut."""

    direction: Tensor  #: (x, y) ``[2, B, 4, N]`` of the link into the body
    arriving: Tensor  #: f'_i at the node outside
    still: Tensor  #: what returns from a skin at rest
    gain: Tensor  #: what returns less per velocity of the skin along the link
    inside: Tensor  #: place of the node inside, int32
    back: Tensor  #: offset of the population that leaves it along the link, int64

    def reflect(self, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Return what comes back from a skin of a velocity, and the force on it, like direction."""
        returning = self.still - self.gain * (self.direction * velocity).sum(0)
        both, lost = self.arriving + returning, self.arriving - returning
        return returning, self.direction * both - velocity * lost


def reflect_(
    bodies: Sequence[BodyConfig],
    params: Sequence[BodyParams],
    states: Sequence[BodyState],
    contact: Contact,
    slots: Slots,
) -> tuple[BodyState, ...]:
    """Reflect outgoing populations at the skin, in place, and return the bodies one step later.

    What returns from a body replaces what leaves the nodes inside it, which is not read.
    """
    (outlines, links), counts, dtype = contact, _count(bodies), slots.data.dtype
    meeting = _meet(states, links, counts, slots)
    each = list(zip(bodies, params, states, outlines, strict=True))
    surfaces = [prescribe_surface(*body, dtype, has_water_inside=False) for body in each]
    velocity = to_links(_join([surface.velocity.mT for surface in surfaces]), links, counts)
    arm = to_links(_join([outline.markers.arm.to(dtype) for outline in outlines]), links, counts)
    changes = [state.slip_impulse.new_zeros(len(state.surplus), 3) for state in states]
    if any(surface.freedoms for surface in surfaces):
        changes = _solve_motion(surfaces, states, meeting, velocity, arm, counts)
        (x, y, turn), (rx, ry) = _spread(changes, counts).to(dtype), arm
        velocity = velocity + torch.stack((x - turn * ry, y + turn * rx))

    # What returns streams back to the nodes outside, from the slots of those inside.
    returning, force = meeting.reflect(velocity)
    slots.write_(meeting.inside, meeting.back, returning, links.sign != 0.0)
    pushes = to_markers(-force, links, counts).split(counts, -1)
    given = (returning - meeting.arriving).split(counts, -1)
    moved = []
    for m, (state, parts) in enumerate(zip(states, each, strict=True)):
        rates = [rate + c for rate, c in zip(surfaces[m].rates, changes[m].unbind(-1), strict=True)]
        felt = RETURN_RATE * state.slip_impulse
        after = move_body(*parts, rates, force=(pushes[m][0], pushes[m][1]), felt=felt)
        surplus = state.surplus + given[m].sum((1, 2)).double()
        moved.append(after._replace(surplus=surplus, slip_impulse=state.slip_impulse - felt))
    return tuple(moved)


def _meet(
    states: Sequence[BodyState], links: Links, counts: Sequence[int], slots: Slots
) -> Meeting:
    """Read the populations at the links; the surplus of each body leaves evenly along its skin."""
    sign, twice = links.sign, 2.0 * links.fraction
    cx, cy, _, _, w = (part.to(sign) for part in slots.families)
    direction, is_cut = torch.stack((sign * cx, sign * cy)), sign.abs()
    node, step = slots.find(links.x, links.y), slots.find(*direction)
    along, against = slots.offsets.along, slots.offsets.against
    there, back = torch.where(sign > 0.0, along, against), torch.where(sign > 0.0, against, along)
    arriving, leaving = slots.read(node, there), slots.read(node, back)
    behind = slots.read(node - step, there)
    inverse = 1.0 / twice.clamp_min(1.0)
    far = (arriving + (twice - 1.0) * leaving) * inverse
    near = twice * arriving + (1.0 - twice) * behind
    rho = 1.0 + compute_moments(slots.read_all(node, slots.offsets.leaving))[0]
    six_w = 6.0 * w * is_cut
    leaks = [
        (RETURN_RATE * state.surplus.to(own) / own.sum((1, 2)).clamp_min(1e-6))[:, None]
        for state, own in zip(states, six_w.split(counts, -1), strict=True)
    ]
    (leak,) = _spread(leaks, counts)
    return Meeting(
        direction=direction,
        arriving=is_cut * arriving,
        still=is_cut * torch.where(twice < 1.0, near, far) - leak * six_w,
        gain=six_w * rho * inverse,
        inside=node + step,
        back=back,
    )


def _solve_motion(
    surfaces: Sequence[Surface],
    states: Sequence[BodyState],
    meeting: Meeting,
    velocity: Tensor,
    arm: Tensor,
    counts: Sequence[int],
) -> list[Tensor]:
    """Return the change ``[B, 3]`` of each body's rates; zero of those that are prescribed.

    Newton's second law gives those that the flow determines: the force is linear in them.
    """
    (rx, ry), (cx, cy), (fx, fy) = arm, meeting.direction, meeting.reflect(velocity)[1]
    # velocity along the link that a unit of each rate gives the skin, and the force along it
    along = [part.split(counts, -1) for part in (cx, cy, rx * cy - ry * cx)]
    loads = [part.split(counts, -1) for part in (fx, fy, rx * fy - ry * fx)]
    gains, changes = meeting.gain.split(counts, -1), []
    for m, (surface, state) in enumerate(zip(surfaces, states, strict=True)):
        felt, axes = RETURN_RATE * state.slip_impulse, [free.axis for free in surface.freedoms]
        drive = [
            loads[free.axis][m].sum((1, 2)).double() + free.push + felt[:, free.axis]
            for free in surface.freedoms
        ]
        matrix = [
            [
                (gains[m] * along[min(a, b)][m] * along[max(a, b)][m]).sum((1, 2)).double()
                for b in axes
            ]
            for a in axes
        ]
        for k, free in enumerate(surface.freedoms):
            matrix[k][k] = matrix[k][k] + free.inertia
        solved = dict(zip(axes, eliminate(matrix, drive), strict=True))
        still = torch.zeros_like(state.surplus)
        changes.append(torch.stack([solved.get(axis, still) for axis in range(3)], -1))
    return changes


def pass_nodes_(
    bodies: Sequence[BodyConfig],
    states: Sequence[BodyState],
    before: Contact,
    after: Contact,
    slots: Slots,
) -> tuple[BodyState, ...]:
    """Fill the nodes that the bodies have left in the step just made, and return the bodies.

    ``states`` are those after the step, ``before`` and ``after`` say where the skins were and are.
    Of the step's outgoing populations, those that arrive at uncovered nodes are set in place. Mass
    of the nodes that changed sides is in the bodies' surplus, momentum with which covered ones
    slipped past in their slip impulse.
    """
    moving = [m for m, body in enumerate(bodies) if not body.is_still]
    if not moving:
        return tuple(states)
    counts, dtype = _count([bodies[m] for m in moving]), slots.data.dtype
    markers = [after.outlines[m].markers for m in moving]
    former = [before.outlines[m].markers.position for m in moving]
    places = torch.cat(former, 1), torch.cat([own.position for own in markers], 1)
    passed = find_passed(*places, counts, slots.size, dtype)
    # the populations that arrive at a covered node, or at the next one outside
    node, turns = slots.find(passed.x, passed.y), passed.turns
    outside = node + slots.find(passed.cx, passed.cy)
    f = slots.read_all(outside, slots.offsets.arriving)
    fluid = compute_macroscopic(f)
    # the skin's velocity in place of the next node's
    skins = [
        compute_velocity(own, states[m].velocity, states[m].angular_velocity)
        for m, own in zip(moving, markers, strict=True)
    ]
    here = _join(skins).to(dtype)
    skin = here + passed.at * (follow(here, counts) - here)
    change = zip(
        f, compute_equilibrium(fluid.drho, *skin), compute_equilibrium(*fluid), strict=True
    )
    filled = torch.stack([own + (new - old) for own, new, old in change], 1)
    slots.write_(node[:, None], slots.offsets.arriving, filled, turns[:, None] < 0.0)
    # water that the skin has covered slipped past it
    covered = turns.clamp_min(0.0) * fluid.rho
    px, py = (covered * (water - own) for water, own in zip(fluid[1:], skin, strict=True))
    each = zip(
        moving,
        *(t.split(counts, -1) for t in (px, py, turns * fluid.drho, passed.x, passed.y)),
        strict=True,
    )
    moved = list(states)
    for m, px, py, mass, x, y in each:
        state = states[m]
        rx, ry = x - state.position[:, :1], y - state.position[:, 1:]
        slip = [part.sum(-1).double() for part in (px, py, rx * py - ry * px)]
        moved[m] = state._replace(
            surplus=state.surplus - mass.sum(-1).double(),
            slip_impulse=state.slip_impulse + torch.stack(slip, -1),
        )
    return tuple(moved)


def _count(bodies: Sequence[BodyConfig]) -> list[int]:
    return [body.num_markers for body in bodies]


def _join(vectors: Sequence[Tensor]) -> Tensor:
    """Return vectors ``[B, N, 2]`` of each body as those of all, ``[2, B, N]``."""
    return torch.cat([own.mT for own in vectors], -1).transpose(0, 1)


def _spread(values: Sequence[Tensor], counts: Sequence[int]) -> Tensor:
    """Return K values ``[B, K]`` of each body at the links of its markers, ``[K, B, 1, N]``."""
    each = [own[..., None].expand(-1, -1, n) for own, n in zip(values, counts, strict=True)]
    return torch.cat(each, -1).transpose(0, 1).unsqueeze(-2)
