"""The grids of a flow with levels: each is an ordinary flow in its own nodes and steps.

They are numbered as in ``FlowConfig.list_grids``: the root, which is the coarsest, and then those
of each patch, coarser ones first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.boundaries import Boundaries, Filled
from fishrl.physics.flow import FlowConfig, FlowParams, FlowState, PatchState
from fishrl.physics.levels.patch import CLEARANCE, Point, find_room, measure_patch
from fishrl.physics.levels.transfer import clamp_origin, fill, fill_all, move, restrict

Pair = tuple[int, int]
FILLED = Boundaries(left=Filled(), right=Filled(), bottom=Filled(), top=Filled())


class Frame(NamedTuple):
    """Size of a patch and its bounds, (x, y) each."""

    size: Pair  #: width and height in its own nodes
    low: Pair  #: least origin in its parent
    high: Pair  #: largest


@dataclass(frozen=True)
class Level:
    """One grid of a flow."""

    config: FlowConfig  #: of the grid as a flow; its tau is the finest level's
    spacing: int  #: of its nodes, in nodes of the finest level
    frame: Frame
    bodies: tuple[int, ...] = ()  #: numbers of the bodies that are in this grid itself
    parent: int = 0  #: number of the grid that it lies in
    centre: Point | None = None  #: (x, y) of a patch that stays, in nodes of the finest level
    leader: int = 0  #: number of the body that another patch follows
    ahead: float = 0.0  #: how far ahead of its centre of mass that body has its middle, nodes
    moves: bool = False  #: whether the patch may have to move

    def convert(self, params: FlowParams) -> FlowParams:
        """Return the parameters of a flow in the units of this grid."""
        return params._replace(
            tau=0.5 + (params.tau - 0.5) / self.spacing,
            ramp_steps=params.ramp_steps / self.spacing,
            ramp_start=params.ramp_start / self.spacing,
            bodies=tuple(params.bodies[index] for index in self.bodies),
        )


@cache
def plan_levels(config: FlowConfig) -> tuple[Level, ...]:
    """Return the grids of a flow."""
    spacing, size = config.coarsest_spacing, config.coarsest_size
    frame = Frame(size, (0, 0), (0, 0))
    if config.levels == 1:
        return (Level(config, 1, frame, tuple(range(len(config.bodies)))),)
    sponges = tuple(
        replace(
            sponge,
            length=-(-sponge.length // spacing),
            tau=max(0.501, 0.5 + (sponge.tau - 0.5) / spacing),
        )
        for sponge in config.sponges
    )
    width, height = size
    root = replace(
        config, width=width, height=height, sponges=sponges, bodies=(), levels=1, patches=()
    )
    grids = [Level(root, spacing, frame)]
    for patch in config.refined:
        low, high = find_room(patch, config.levels, config.list_bounds())
        leader = config.bodies[patch.numbers[0]] if patch.centre is None else None
        sizes = measure_patch(patch, config.bodies, config.levels, config.list_bounds())
        for depth, (width, height) in enumerate(sizes, 1):
            bodies = patch.numbers if depth == len(sizes) else ()
            grid = replace(
                root,
                width=width,
                height=height,
                boundaries=FILLED,
                sponges=(),
                bodies=tuple(config.bodies[index] for index in bodies),
            )
            frame = Frame((width, height), low, (high[0] - width // 2, high[1] - height // 2))
            own = Level(grid, spacing >> depth, frame, bodies, len(grids) - 1 if depth > 1 else 0)
            if leader is None:
                grids.append(replace(own, centre=patch.centre))
            else:
                ahead, moves = leader.centre - 0.5 * leader.size, not leader.motion.is_still
                grids.append(replace(own, leader=patch.numbers[0], ahead=ahead, moves=moves))
            low, high = (CLEARANCE,) * 2, (width - 1 - CLEARANCE, height - 1 - CLEARANCE)
    return tuple(grids)


def list_chains(levels: Sequence[Level]) -> list[list[int]]:
    """Return the numbers of the grids of each patch, coarser ones first."""
    chains: list[list[int]] = []
    for number, level in enumerate(levels[1:], 1):
        if level.parent == 0:
            chains.append([])
        chains[-1].append(number)
    return chains


def find_corners(levels: Sequence[Level], origins: Sequence[Tensor]) -> list[Tensor]:
    """Return the place ``[B, 2]`` of the first node of each grid, in nodes of the finest level."""
    corners = [origins[0]]
    for level, origin in zip(levels[1:], origins[1:], strict=True):
        corners.append(corners[level.parent] + levels[level.parent].spacing * origin)
    return corners


def place_patches(
    levels: Sequence[Level], bodies: Sequence[BodyState], like: Tensor
) -> list[Tensor]:
    """Return the origins ``[B, 2]`` of all grids with which bodies are in the middle of patches.

    ``like`` ``[B, ...]`` tells their number and device.
    """
    origins = [torch.zeros(len(like), 2, dtype=torch.int64, device=like.device)]
    for number, level in enumerate(levels[1:], 1):
        corner = find_corners(levels[:number], origins)[level.parent]
        place = (find_point(level, bodies, like) - corner) / levels[level.parent].spacing
        first = [
            p - 0.5 * (n // 2) for p, n in zip(place.unbind(-1), level.frame.size, strict=True)
        ]
        origin = torch.stack(first, -1).nan_to_num().round().long()
        origins.append(clamp_origin(origin, level.frame.low, level.frame.high))
    return origins


def find_point(level: Level, bodies: Sequence[BodyState], like: Tensor) -> Tensor:
    """Return the point ``[B, 2]`` that a patch keeps in its middle, in finest nodes."""
    if level.centre is None:
        return find_middle(bodies[level.leader], level.ahead)
    numbers = (like.new_full((len(like),), at, dtype=torch.float64) for at in level.centre)
    return torch.stack(list(numbers), -1)  # without a copy from the host


def find_middle(body: BodyState, ahead: float) -> Tensor:
    """Return the point ``[B, 2]`` that lies ``ahead`` of a body's centre of mass."""
    axis = torch.stack((torch.cos(body.heading), torch.sin(body.heading)), -1)
    return (body.position + ahead * axis).detach()


def choose_shifts(
    place: Tensor, origins: Sequence[Tensor], frames: Sequence[Frame]
) -> list[Tensor]:
    """Return by how many parent nodes ``[B, 2]`` to move the grids of a patch: -1, 0, 1 each.

    A grid moves when the followed ``place`` ``[B, 2]``, given in nodes of the finest, is more than
    two of its nodes from its middle, as far as its bounds and those of the next finer one allow.
    Origins ``[B, 2]`` and frames are those of the grids, coarser ones first.
    """
    shifts: list[Tensor] = []
    inside: tuple[Tensor, Frame] | None = None
    for origin, frame in reversed(list(zip(origins, frames, strict=True))):
        # numbers, as compiled code keeps no constant tensors
        ahead = [p - 0.5 * (n - 1) for p, n in zip(place.unbind(-1), frame.size, strict=True)]
        wanted = torch.stack([(d > 2.0).long() - (d < -2.0).long() for d in ahead], -1)
        by = clamp_origin(origin + wanted, frame.low, frame.high) - origin
        if inside is not None:
            after = inside[0] - 2 * by
            by = torch.where(clamp_origin(after, *inside[1][1:]) == after, by, 0)
        shifts.insert(0, by)
        place, inside = origin + 0.5 * place, (origin + by, frame)
    return shifts


def make_patches(state: FlowState, config: FlowConfig, params: FlowParams) -> FlowState:
    """Return a flow whose patches lie around its bodies, filled by the coarsest level."""
    levels, grids = plan_levels(config), [state.f]
    origins = place_patches(levels, state.bodies, state.f)
    for level, origin in zip(levels[1:], origins[1:], strict=True):
        tau = level.convert(params).tau
        grids.append(fill_all(level.frame.size, grids[level.parent], origin, tau))
    return state._replace(patches=tuple(map(PatchState, grids[1:], origins[1:])))


class Grids:
    """The grids of a batch of flows within a readable step.

    Attributes:
        levels: the grids.
        params: parameters of each.
        origins: place ``[B, 2]`` of each in its parent.
        flows: each as a flow in its own nodes and steps, with the bodies in it.
    """

    def __init__(self, state: FlowState, config: FlowConfig, params: FlowParams) -> None:
        self.levels = plan_levels(config)
        self.params = [level.convert(params) for level in self.levels]
        zero = torch.zeros(len(state.f), 2, dtype=torch.int64, device=state.f.device)
        self.origins = [zero, *(patch.origin for patch in state.patches)]
        grids = state.f, *(patch.f for patch in state.patches)
        corners = find_corners(self.levels, self.origins)
        self.flows = []
        for level, f, corner in zip(self.levels, grids, corners, strict=True):
            own = [state.bodies[index] for index in level.bodies]
            bodies = tuple(body._replace(position=body.position - corner) for body in own)
            self.flows.append(FlowState(f, bodies))
        if state.clock is not None:
            clock = state.clock / self.levels[0].spacing
            self.flows[0] = self.flows[0]._replace(clock=clock)

    def collect(self) -> FlowState:
        """Return the flows, with bodies and clock in nodes and steps of the finest level."""
        bodies: dict[int, BodyState] = {}
        for level, flow, corner in zip(
            self.levels, self.flows, find_corners(self.levels, self.origins), strict=True
        ):
            for index, body in zip(level.bodies, flow.bodies, strict=True):
                bodies[index] = body._replace(position=body.position + corner)
        f, _, clock, _ = self.flows[0]
        return FlowState(
            f,
            bodies=tuple(bodies[index] for index in sorted(bodies)),
            clock=None if clock is None else clock * self.levels[0].spacing,
            patches=tuple(
                PatchState(flow.f, origin)
                for flow, origin in zip(self.flows[1:], self.origins[1:], strict=True)
            ),
        )

    def list_inside(self, number: int) -> list[int]:
        """Return the numbers of the grids that lie directly in a grid."""
        return [n for n, level in enumerate(self.levels) if n and level.parent == number]

    def fill(self, number: int) -> None:
        """Let the parent of a grid fill its ring."""
        f, parent = self.flows[number].f, self.flows[self.levels[number].parent].f
        filled = fill(f, parent, self.origins[number], self.params[number].tau)
        self.flows[number] = self.flows[number]._replace(f=filled)

    def restrict(self, number: int) -> None:
        """Give the nodes under a grid its moments."""
        parent, f = self.levels[number].parent, self.flows[number].f
        taken = restrict(self.flows[parent].f, f, self.origins[number], self.params[number].tau)
        self.flows[parent] = self.flows[parent]._replace(f=taken)

    def shift(self) -> None:
        """Move patches after their bodies, by a node of their parents, where that is due."""
        for number in range(1, len(self.levels)):
            self.fill(number)  # what lies in the ring moves inwards
        for chain in list_chains(self.levels):
            finest = self.levels[chain[-1]]
            if finest.moves:
                place = find_middle(self.flows[chain[-1]].bodies[0], finest.ahead)
                origins, frames = zip(
                    *((self.origins[n], self.levels[n].frame) for n in chain), strict=True
                )
                self.move(chain, choose_shifts(place, origins, frames))

    def move(self, chain: Sequence[int], shifts: Sequence[Tensor]) -> None:
        """Move the grids of a patch by nodes of their parents ``[B, 2]``, coarser ones first."""
        outer = torch.zeros_like(shifts[0])
        for number, by in zip(chain, shifts, strict=True):
            flow = self.flows[number]
            f = torch.stack(move(flow.f.unbind(1), by), 1)
            own = (body._replace(position=body.position - 2 * by) for body in flow.bodies)
            self.flows[number] = flow._replace(f=f, bodies=tuple(own))
            self.origins[number] = self.origins[number] + by - 2 * outer
            outer = by
