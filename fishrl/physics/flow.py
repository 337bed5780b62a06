"""A flow: its static configuration, its parameters and its state."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, pi
from typing import Annotated, ClassVar, NamedTuple

import torch
from pydantic import Field, NonNegativeInt, PositiveInt
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.outline import BodyConfig, BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.boundaries import Boundaries, Periodic, Side
from fishrl.physics.collision import Rates, compute_equilibrium
from fishrl.physics.lattice import MAX_IMPOSED_SPEED, Q
from fishrl.physics.levels.patch import (
    CLEARANCE,
    RING,
    Patch,
    find_room,
    fit_patch,
    inset,
    measure_patch,
)
from fishrl.physics.skins import BounceBack, Skin
from fishrl.physics.units import check_tau
from fishrl.settings import Settings


class Sponge(Settings):
    """A strip along an edge where the viscosity rises smoothly and damps vortices and sound.

    Args:
        length: width of the strip, nodes.
        tau: relaxation time at the edge itself; that of the flow where it is larger.
        side: which edge.
    """

    length: PositiveInt
    tau: float = 1.0
    side: Side = Side.RIGHT

    def __post_init__(self) -> None:
        check_tau(self.tau)


class FlowConfig(Settings):
    """The static configuration of a flow.

    Flows of one batch may differ in ``tau``, ``stream_speed``, ``ramp_steps`` and in the size, gait
    and density of their bodies (with equal ``num_markers``); everything else must be equal.

    Args:
        width: nodes along x.
        height: nodes along y.
        tau: relaxation time of the stresses; nu = (tau - 1/2) / 3.
        stream_speed: unit of the velocities that the edges impose, nodes per step.
        ramp_steps: steps over which the stream rises smoothly from rest; with 0 it starts at full
            speed.
        bodies: bodies in the flow; if there is a fish, the first body must be one.
        rates: relaxation rates of the other moments.
        boundaries: the four edges.
        sponges: strips of raised viscosity.
        skin: how bodies and fluid act on each other: ``BounceBack()``, a sharp skin, or
            ``ImmersedBoundary()``, the paper's. Bodies take their marker spacing and inset from it.
        levels: grids of different spacing. With 1 there is one grid; with more, only patches have
            the spacing that everything else here is in, and each coarser level has twice that of
            the next finer one. Then the width less one, and likewise the height, is a multiple of
            2^(levels - 1), or with periodic edges the width itself.
        patches: where the finer levels are; by default around each body. Not read with one level.
    """

    former: ClassVar[Mapping[str, str]] = {
        "coupling": "give skin=BounceBack(), the default, or skin=ImmersedBoundary()",
        "force_solve": "give skin=ImmersedBoundary(force_solve=...)",
    }

    width: Annotated[int, Field(ge=4, le=2**31 - 1)]
    height: Annotated[int, Field(ge=4, le=2**31 - 1)]
    tau: float
    stream_speed: float = 1.0
    ramp_steps: NonNegativeInt = 0
    bodies: tuple[BodyConfig, ...] = ()
    rates: Rates = Rates()
    boundaries: Boundaries = Boundaries()
    sponges: tuple[Sponge, ...] = ()
    skin: Skin = BounceBack()
    levels: Annotated[int, Field(ge=1, le=6)] = 1
    patches: tuple[Patch, ...] = ()

    def __post_init__(self) -> None:
        check_tau(self.tau)
        object.__setattr__(self, "bodies", tuple(map(self.skin.fit, self.bodies)))
        if self.fish is None and any(isinstance(body, Fish) for body in self.bodies):
            names = [type(body).__name__ for body in self.bodies]
            raise ValueError(f"bodies = {names}: the fish must come first")
        if self.fastest_edge > MAX_IMPOSED_SPEED:
            raise ValueError(
                f"an edge imposes {self.fastest_edge:.3f} nodes per step, allowed is "
                f"{MAX_IMPOSED_SPEED} (Mach 0.52): lower stream_speed"
            )
        self.boundaries.check_balance(self.width, self.height)
        for sponge in self.sponges:
            if sponge.length > (self.width if sponge.side.value[0] else self.height):
                raise ValueError(
                    f"Sponge of {sponge.length} nodes does not fit into {self.width} x "
                    f"{self.height} nodes: shorten it or enlarge the domain"
                )
        for body in self.bodies:
            if body.size > min(self.width, self.height) - 4:
                raise ValueError(
                    f"{type(body).__name__} of {body.size:g} nodes does not fit into {self.width} "
                    f"x {self.height} nodes: enlarge the domain or make the body smaller"
                )
        if self.levels > 1:
            self._check_levels()

    def _check_levels(self) -> None:
        """Raise ValueError for sizes and patches that levels do not allow."""
        given = sorted(index for patch in self.refined for index in patch.numbers)
        if not self.refined or given != list(range(len(self.bodies))):
            raise ValueError(
                f"patches hold the bodies {given} of {len(self.bodies)}: give each body in one "
                "Patch(bodies=...), and at least one patch"
            )
        for name, size, edge in (
            ("width", self.width, self.boundaries.left),
            ("height", self.height, self.boundaries.bottom),
        ):
            rest = (size - (not isinstance(edge, Periodic))) % self.coarsest_spacing
            if rest:
                raise ValueError(
                    f"{name} = {size} with levels = {self.levels}: take {size - rest} or "
                    f"{size - rest + self.coarsest_spacing}, to end on a node of the coarsest level"
                )
        for patch in self.refined:
            width, height = measure_patch(patch, self.bodies, self.levels, self.list_bounds())[0]
            (left, bottom), (right, top) = find_room(patch, self.levels, self.list_bounds())
            if width // 2 > right - left or height // 2 > top - bottom:
                unit = self.coarsest_spacing
                raise ValueError(
                    f"{patch} covers {width // 2 * unit} x {height // 2 * unit} nodes on its "
                    f"coarsest level, there are {(right - left) * unit} x {(top - bottom) * unit} "
                    f"away from edges and sponges{' in its box' if patch.within else ''}: take "
                    "fewer levels or enlarge the domain"
                )

    @property
    def refined(self) -> tuple[Patch, ...]:
        """The patches of the finer levels, with their bodies' numbers; none with one level."""
        if self.levels == 1:
            return ()
        num, bounds = len(self.bodies), self.list_bounds()
        given = self.patches or [Patch(bodies=(index,)) for index in range(num)]
        return tuple(fit_patch(patch, num, self.levels, bounds) for patch in given)

    @property
    def coarsest_spacing(self) -> int:
        """Distance of the nodes of the coarsest level, 2^(levels - 1)."""
        return int(2 ** (self.levels - 1))

    @property
    def coarsest_size(self) -> tuple[int, int]:
        """Width and height of the coarsest level in its own nodes."""
        unit = self.coarsest_spacing
        return -(-self.width // unit), -(-self.height // unit)

    def list_bounds(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the first and last node (x, y) of the coarsest level that a patch may cover."""
        low, high = [CLEARANCE] * 2, [size - 1 - CLEARANCE for size in self.coarsest_size]
        for sponge in self.sponges:
            nodes = -(-sponge.length // self.coarsest_spacing)
            axis = 0 if sponge.side.value[0] else 1
            if sponge.side.value[axis] > 0:
                low[axis] = max(low[axis], nodes + CLEARANCE)
            else:
                last = self.coarsest_size[axis] - 1
                high[axis] = min(high[axis], last - nodes - CLEARANCE)
        return (low[0], low[1]), (high[0], high[1])

    @property
    def edges(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and largest (x, y) of the water that bodies may be in, nodes.

        It ends at the edges, with levels also where sponges begin.
        """
        if self.levels == 1:
            return (0, 0), (self.width - 1, self.height - 1)
        low, high, unit = *self.list_bounds(), self.coarsest_spacing
        first, last = (
            [unit * (n + sign * CLEARANCE) for n in end] for sign, end in ((-1, low), (1, high))
        )
        return (first[0], first[1]), (last[0], last[1])

    @property
    def reach(self) -> float:
        """Distance from ``edges`` that markers must keep, nodes."""
        # each patch keeps from its parent's edges; the skin reads within the finest one's ring
        within = CLEARANCE * self.coarsest_spacing + inset(0, self.levels) + RING
        return self.skin.margin + (within if self.levels > 1 else 0)

    @property
    def body_bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and largest (x, y) of markers that a body may have, nodes."""
        (left, bottom), (right, top), reach = *self.edges, self.reach
        return (left + reach, bottom + reach), (right - reach, top - reach)

    @property
    def nu(self) -> float:
        """Kinematic viscosity in lattice units."""
        return (self.tau - 0.5) / 3.0

    @property
    def num_bytes(self) -> int:
        """Bytes of one flow in single precision, with rings of its grids and relaxation rates."""
        cells = sum((width + 10) * (height + 2) for width, height, _ in self.list_grids())
        return 4 * (Q + bool(self.sponges)) * cells

    def list_grids(self) -> list[tuple[int, int, int]]:
        """Return width and height of each grid in its own nodes, and their spacing, coarsest first.

        The spacing is also the number of steps after which its nodes are updated.
        """
        grids = [(*self.coarsest_size, self.coarsest_spacing)]
        for patch in self.refined:
            sizes = measure_patch(patch, self.bodies, self.levels, self.list_bounds())
            grids += [(*size, 2**k) for k, size in enumerate(reversed(sizes))][::-1]
        return grids

    @property
    def fish(self) -> Fish | None:
        """The first body, if it is a fish."""
        first = self.bodies[0] if self.bodies else None
        return first if isinstance(first, Fish) else None

    @property
    def is_still(self) -> bool:
        """Whether no body ever moves or deforms."""
        return all(body.is_still for body in self.bodies)

    @property
    def fastest_edge(self) -> float:
        """Largest speed that an edge imposes, nodes per step."""
        edges = [edge for group in self.boundaries.in_order() for _, edge in group]
        speeds = [hypot(*edge.imposed_velocity) for edge in edges]
        return abs(self.stream_speed) * max(speeds, default=0.0)

    @property
    def inflow(self) -> tuple[float, float]:
        """Mean velocity (x, y) of the edges where fluid enters, in units of ``stream_speed``.

        Without their profiles.
        """
        edges = [edge for group in self.boundaries.in_order() for edge in group]
        given = [(side.value, boundary.imposed_velocity) for side, boundary in edges]
        entering = [v for normal, v in given if normal[0] * v[0] + normal[1] * v[1] > 0.0]
        num = max(1, len(entering))
        return sum(x for x, _ in entering) / num, sum(y for _, y in entering) / num

    @property
    def updates_per_step(self) -> float:
        """Nodes that a step updates; with levels, in the mean."""
        return sum(width * height / spacing for width, height, spacing in self.list_grids())

    def get_structure(self) -> object:
        """Return what all flows of one batch must share."""
        bodies = tuple((body.num_markers, body.get_structure()) for body in self.bodies)
        alike = replace(
            self, tau=1.0, stream_speed=0.0, ramp_steps=0, bodies=(), levels=1, patches=()
        )
        return alike, bodies, self.levels, self.patches, self.list_grids()

    def compute_omega(self, tau: Tensor) -> Tensor:
        """Return the relaxation rate 1 / tau, ``[B, 1, 1]``, or ``[B, Y, X]`` with sponges."""
        field = tau.double()[:, None, None]
        x, y = torch.arange(self.width).double(), torch.arange(self.height).double()[:, None]
        for sponge in self.sponges:
            nx, ny = sponge.side.value
            depth = x * nx + y * ny + (nx < 0) * (self.width - 1) + (ny < 0) * (self.height - 1)
            weight = torch.sin(0.5 * pi * (1.0 - depth / sponge.length).clamp(0.0)) ** 2
            field = field + (sponge.tau - field).clamp_min(0.0) * weight.to(field)
        return 1.0 / field


class FlowParams(NamedTuple):
    """What may differ between the flows of a batch, float64."""

    tau: Tensor  #: ``[B]`` relaxation time
    stream_speed: Tensor  #: ``[B]`` nodes per step, once the last change is over
    #: ``[B]`` duration of that change in steps; initially the rise of the stream
    ramp_steps: Tensor
    former_speed: Tensor  #: ``[B]`` speed before that change, nodes per step; 0 at rest
    ramp_start: Tensor  #: ``[B]`` beginning of that change, steps since the start
    bodies: tuple[BodyParams, ...]  #: parameters of each body


class FlowState(NamedTuple):
    """State of a batch of flows."""

    #: ``[B, Q, Y, X]`` incoming populations, shifted by the weights; of the coarsest level
    f: Tensor
    bodies: tuple[BodyState, ...] = ()  #: state of each body
    #: ``[B]`` steps since the start; None means that the stream no longer changes
    clock: Tensor | None = None
    patches: tuple["PatchState", ...] = ()  #: finer grids, as ``FlowConfig.list_grids`` has them


class PatchState(NamedTuple):
    """A finer grid and its place."""

    f: Tensor  #: ``[B, Q, Y, X]`` incoming populations
    origin: Tensor  #: ``[B, 2]`` int64, (x, y) of its first node in its parent's nodes


def make_rest(config: FlowConfig, num_envs: int, dtype: torch.dtype = torch.float64) -> Tensor:
    """Return the populations ``[B, Q, Y, X]`` of a fluid at rest, of the coarsest level."""
    width, height = config.coarsest_size
    return torch.zeros(num_envs, Q, height, width, dtype=dtype)


def make_uniform(drho: Tensor, ux: Tensor, uy: Tensor) -> Tensor:
    """Return equilibrium populations ``[B, Q, Y, X]`` of ``[B, Y, X]`` fields (rho - 1, u)."""
    return torch.stack(compute_equilibrium(drho, ux, uy), 1)


def make_params(configs: Sequence[FlowConfig], device: torch.device | str = "cpu") -> FlowParams:
    """Return the parameters of one flow per configuration.

    Raises:
        ValueError: if the flows cannot share a batch.
    """
    for i, config in enumerate(configs):
        if config.get_structure() != configs[0].get_structure():
            raise ValueError(
                f"flow {i} differs from flow 0 in more than tau, stream_speed, ramp_steps and the "
                "size, gait and density of bodies: flows of one batch share everything else, the "
                "number of markers of each body included (set num_markers), and with levels the "
                "size of patches (set Patch(size=...))"
            )
    numbers = [[c.tau, c.stream_speed, float(c.ramp_steps)] for c in configs]
    tau, speed, ramp = torch.tensor(numbers, dtype=torch.float64, device=device).unbind(-1)
    made: dict[BodyConfig, BodyParams] = {}
    for config in configs:
        for body in config.bodies:
            if body not in made:
                made[body] = body.make_params(device)
    bodies = tuple(
        pytree.tree_map(lambda *each: torch.cat(each), *(made[body] for body in counterparts))
        for counterparts in zip(*(config.bodies for config in configs), strict=True)
    )
    return FlowParams(tau, speed, ramp, torch.zeros_like(speed), torch.zeros_like(speed), bodies)


def compute_stream_speed(params: FlowParams, clock: Tensor) -> Tensor:
    """Return the stream speed ``[B]`` at ``clock``.

    It is U_0 + (U - U_0) (1 - cos(pi t / t_ramp)) / 2 at time t after the change began, and U after
    t_ramp.
    """
    age = clock - params.ramp_start
    is_ramp = params.ramp_steps > 0.0  # never divided by 0, whose gradient would not be finite
    part = torch.where(is_ramp, age / torch.where(is_ramp, params.ramp_steps, 1.0), 1.0)
    part = part.clamp(max=1.0)
    change = params.stream_speed - params.former_speed
    return params.former_speed + change * 0.5 * (1.0 - torch.cos(pi * part))


def change_stream_speed(
    params: FlowParams, clock: Tensor, speed: Tensor, num_steps: int | None
) -> FlowParams:
    """Return parameters with which the stream changes to ``speed`` ``[B]`` from ``clock`` on.

    It does so smoothly over ``num_steps``. With None it changes immediately, while a rise from rest
    continues to the new speed.
    """
    new = params._replace(stream_speed=speed)
    if num_steps is None:
        is_rising = params.former_speed == 0.0
        return new._replace(ramp_steps=torch.where(is_rising, params.ramp_steps, 0.0))
    if num_steps < 0:
        raise ValueError(f"num_steps = {num_steps}: must be 0 or more")
    return new._replace(
        ramp_steps=torch.full_like(clock, num_steps),
        former_speed=compute_stream_speed(params, clock),
        ramp_start=clock.clone(),
    )
