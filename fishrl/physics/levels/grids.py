"""The grids of a flow with levels: each is an ordinary flow in its own nodes and steps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.outline import BodyConfig
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.boundaries import Boundaries, Filled
from fishrl.physics.flow import FlowConfig, FlowParams, FlowState, PatchState
from fishrl.physics.levels.patch import CLEARANCE, Patch, find_room, measure_patch
from fishrl.physics.levels.transfer import (
    choose_shift,
    clamp_origin,
    fill,
    fill_all,
    move,
    restrict,
)

Pair = tuple[int, int]
FILLED = Boundaries(left=Filled(), right=Filled(), bottom=Filled(), top=Filled())


class Frame(NamedTuple):
    """Size of a patch and its bounds, (x, y) each."""

    size: Pair  #: width and height in its own nodes
    low: Pair  #: least origin in its parent
    high: Pair  #: largest


@dataclass(frozen=True)
class Level:
    """One grid of a flow, and those inside it."""

    config: FlowConfig  #: of the grid as a flow; its tau is the finest level's
    spacing: int  #: of its nodes, in nodes of the finest level
    patch: Patch | None  #: that it belongs to; None for the root
    leader: BodyConfig | None  #: body that the patch follows
    frame: Frame
    patches: tuple["Level", ...]

    @property
    def bodies(self) -> tuple[int, ...]:
        """Numbers of the bodies that are in this grid itself."""
        return self.patch.numbers if self.patch and not self.patches else ()

    @property
    def follows(self) -> bool:
        """Whether it is a patch that may have to move."""
        is_free = self.leader is not None and not self.leader.motion.is_still
        return is_free and self.patch is not None and self.patch.centre is None

    @property
    def ahead(self) -> float:
        """How far ahead of its centre of mass the body that is followed has its middle, nodes."""
        return self.leader.centre - 0.5 * self.leader.size if self.leader else 0.0

    def convert(self, params: FlowParams) -> FlowParams:
        """Return the parameters of a flow in the units of this grid."""
        return params._replace(
            tau=0.5 + (params.tau - 0.5) / self.spacing,
            ramp_steps=params.ramp_steps / self.spacing,
            ramp_start=params.ramp_start / self.spacing,
            bodies=tuple(params.bodies[index] for index in self.bodies),
        )


@cache
def plan_levels(config: FlowConfig) -> Level:
    """Return the root of a flow's grids."""
    spacing = config.coarsest_spacing
    width, height = config.coarsest_size
    sponges = tuple(
        replace(
            sponge,
            length=-(-sponge.length // spacing),
            tau=max(0.501, 0.5 + (sponge.tau - 0.5) / spacing),
        )
        for sponge in config.sponges
    )
    root = replace(
        config, width=width, height=height, sponges=sponges, bodies=(), levels=1, patches=()
    )
    patches = tuple(_plan_patch(config, patch) for patch in config.refined)
    return Level(root, spacing, None, None, Frame((width, height), (0, 0), (0, 0)), patches)


def _plan_patch(config: FlowConfig, patch: Patch) -> Level:
    """Return the coarsest grid of a patch, with the finer ones in it."""
    inside: tuple[Level, ...] = ()
    sizes = measure_patch(patch, config.bodies, config.levels, config.list_bounds())
    leader = config.bodies[patch.numbers[0]] if patch.bodies else None
    for number, (width, height) in reversed(list(enumerate(sizes))):
        if number:
            parent = sizes[number - 1]
            low = CLEARANCE, CLEARANCE
            high = parent[0] - 1 - CLEARANCE, parent[1] - 1 - CLEARANCE
        else:
            low, high = find_room(patch, config.levels, config.list_bounds())
        bodies = () if inside else tuple(config.bodies[index] for index in patch.numbers)
        grid = replace(
            config,
            width=width,
            height=height,
            boundaries=FILLED,
            sponges=(),
            bodies=bodies,
            levels=1,
            patches=(),
        )
        last = high[0] - width // 2, high[1] - height // 2
        spacing = 2 ** (len(sizes) - 1 - number)
        frame = Frame((width, height), low, last)
        inside = (Level(grid, spacing, patch, leader, frame, inside),)
    return inside[0]


def make_patches(state: FlowState, config: FlowConfig, params: FlowParams) -> FlowState:
    """Return a flow whose patches lie around its bodies, filled by the coarsest level."""
    return _make_inside(state, plan_levels(config), params, state.bodies, _start(state))


def _make_inside(
    state: FlowState,
    level: Level,
    params: FlowParams,
    bodies: tuple[BodyState, ...],
    corner: Tensor,
) -> FlowState:
    patches = []
    for finer in level.patches:
        place = (find_point(finer, bodies, corner) - corner) / level.spacing
        origin = place_patch(place, finer.frame)
        flow = FlowState(fill_all(finer.frame.size, state.f, origin, finer.convert(params).tau))
        own = corner + level.spacing * origin
        patches.append(PatchState(_make_inside(flow, finer, params, bodies, own), origin))
    return state._replace(patches=tuple(patches))


def place_patch(place: Tensor, frame: Frame) -> Tensor:
    """Return the origin ``[B, 2]`` of a patch around a place in its parent's nodes."""
    first = [p - 0.5 * (n // 2) for p, n in zip(place.unbind(-1), frame.size, strict=True)]
    origin = torch.stack(first, -1).nan_to_num().round().long()
    return clamp_origin(origin, frame.low, frame.high)


def find_point(level: Level, bodies: Sequence[BodyState], like: Tensor) -> Tensor:
    """Return the point ``[B, 2]`` that a patch keeps in its middle, in finest nodes."""
    assert level.patch is not None
    if level.leader is None or level.patch.centre is not None:
        assert level.patch.centre is not None
        at = [like.new_full(like.shape[:1], c, dtype=torch.float64) for c in level.patch.centre]
        return torch.stack(at, -1)
    state = bodies[level.patch.numbers[0]]
    return find_middle(state.position, state.heading, level.ahead)


def find_middle(position: Tensor, heading: Tensor, ahead: float) -> Tensor:
    """Return the point ``[B, 2]`` that lies ``ahead`` of a body's centre of mass."""
    axis = torch.stack((torch.cos(heading), torch.sin(heading)), -1)
    return (position + ahead * axis).detach()


def shift(state: FlowState, level: Level, params: FlowParams) -> FlowState:
    """Return a flow whose patches have moved by a node of their parents where that is due."""
    return _shift_inside(state, level, params, state.bodies, _start(state))


def _shift_inside(
    state: FlowState,
    level: Level,
    params: FlowParams,
    bodies: tuple[BodyState, ...],
    corner: Tensor,
) -> FlowState:
    moved = []
    state = fill_patches(state, level, params)  # what lies in the ring moves inwards
    for (flow, origin), finer in zip(state.patches, level.patches, strict=True):
        start = corner + level.spacing * origin
        flow = _shift_inside(flow, finer, params, bodies, start)
        place = (find_point(finer, bodies, corner) - start) / finer.spacing
        inside = [
            (patch.origin, own.frame)
            for patch, own in zip(flow.patches, finer.patches, strict=True)
        ]
        by = find_shift(place, origin, finer.frame, inside)
        moved.append(move_patch(PatchState(flow, origin), by))
    return state._replace(patches=tuple(moved))


def find_shift(
    place: Tensor, origin: Tensor, frame: Frame, inside: Sequence[tuple[Tensor, Frame]]
) -> Tensor:
    """Return ``choose_shift`` of a patch, as far as those inside it allow, by their origins."""
    by = choose_shift(place, origin, *frame)
    for own, finer in inside:
        after = own - 2 * by
        by = torch.where(clamp_origin(after, finer.low, finer.high) == after, by, 0)
    return by


def move_patch(patch: PatchState, by: Tensor) -> PatchState:
    """Return a patch moved by nodes of its parent ``[B, 2]``, while those inside stay in place."""
    flow, origin = patch
    inside = tuple(p._replace(origin=p.origin - 2 * by) for p in flow.patches)
    f = torch.stack(move(flow.f.unbind(1), by), 1)
    return PatchState(flow._replace(f=f, patches=inside), origin + by)


def fill_patches(state: FlowState, level: Level, params: FlowParams) -> FlowState:
    """Return a flow that has filled the rings of the patches in it."""
    patches = []
    for (flow, origin), finer in zip(state.patches, level.patches, strict=True):
        f = fill(flow.f, state.f, origin, finer.convert(params).tau)
        patches.append(PatchState(flow._replace(f=f), origin))
    return state._replace(patches=tuple(patches))


def restrict_patches(state: FlowState, level: Level, params: FlowParams) -> FlowState:
    """Return a flow whose nodes under the patches in it have their moments."""
    f = state.f
    for (flow, origin), finer in zip(state.patches, level.patches, strict=True):
        f = restrict(f, flow.f, origin, finer.convert(params).tau)
    return state._replace(f=f)


def hand_down(state: FlowState, level: Level) -> FlowState:
    """Return a flow with each body in its finest grid, each grid in its own nodes and steps."""
    clock = None if state.clock is None else state.clock / level.spacing
    return _hand_down(state._replace(clock=clock), level, state.bodies, _start(state))


def _hand_down(
    state: FlowState, level: Level, bodies: tuple[BodyState, ...], corner: Tensor
) -> FlowState:
    patches = []
    for (flow, origin), finer in zip(state.patches, level.patches, strict=True):
        flow = _hand_down(flow, finer, bodies, corner + level.spacing * origin)
        patches.append(PatchState(flow, origin))
    own = [bodies[index] for index in level.bodies]
    own = [body._replace(position=body.position - corner) for body in own]
    return state._replace(bodies=tuple(own), patches=tuple(patches))


def hand_up(state: FlowState, level: Level) -> FlowState:
    """Return what ``hand_down`` was given: bodies and clock in nodes and steps of the finest."""
    bodies: dict[int, BodyState] = {}
    state = _hand_up(state, level, bodies, _start(state))
    clock = None if state.clock is None else state.clock * level.spacing
    return state._replace(bodies=tuple(bodies[i] for i in sorted(bodies)), clock=clock)


def _hand_up(
    state: FlowState, level: Level, bodies: dict[int, BodyState], corner: Tensor
) -> FlowState:
    for index, body in zip(level.bodies, state.bodies, strict=True):
        bodies[index] = body._replace(position=body.position + corner)
    patches = []
    for (flow, origin), finer in zip(state.patches, level.patches, strict=True):
        flow = _hand_up(flow, finer, bodies, corner + level.spacing * origin)
        patches.append(PatchState(flow._replace(clock=None), origin))
    return state._replace(bodies=(), patches=tuple(patches))


def _start(state: FlowState) -> Tensor:
    """Return the place ``[B, 2]`` of the root's first node."""
    return torch.zeros(len(state.f), 2, dtype=torch.int64, device=state.f.device)
