"""Streams of several speeds, which may change within an episode, with or without half discs."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from math import floor, inf, pi
from typing import Annotated, Any

import torch
from pydantic import Field, PositiveFloat, PositiveInt
from tensordict import TensorDictBase
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.envs.changes import StreamSwitches
from fishrl.envs.constants import make_constant
from fishrl.envs.scene import Area
from fishrl.envs.starts import place_fish
from fishrl.envs.task import AbstractTask
from fishrl.envs.wakes import WakeBank, WakeRecipe, load_wakes
from fishrl.physics.bodies.outline import BodyConfig, BodyParams, DCylinder
from fishrl.physics.boundaries import Boundaries
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig
from fishrl.physics.units import MAX_WALL_SPEED
from fishrl.settings import Settings


class Stream(Settings):
    """Streams along +x that differ in speed and in the diameter of their half disc.

    Their edges are those of ``Boundaries.make_stream``. The flat side of the half disc faces
    downstream as in Liao et al. 2003 (the paper does not specify it).

    Args:
        speeds_bl: stream speeds, L / T; by default the paper's conditions I, II and III.
        changes: changes of the speed within an episode, which begins at one of ``speeds_bl``; None
            for steady streams.
        has_disc: include the half disc; positions refer to its location in a free stream too.
        diameter_bl: D of the half disc, body lengths, one for all streams or one for each. Discs of
            different D have as many markers as the largest, on which they lie half a node apart, or
            a node with the immersed boundary.
        face_bl: distance of its flat side from the inflow.
        num_phases: wake snapshots per shedding period from which episodes start.
        num_travels: development time of a wake, D / U; see ``wakes.WakeRecipe``.
        wake_folder: cache of developed wakes; a relative folder that does not hold them stands for
            ``~/.cache/fishrl/wakes``. Delete its files to clear it.
    """

    speeds_bl: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = (1.0, 1.25, 1.5)
    changes: StreamSwitches | None = None
    has_disc: bool = True
    diameter_bl: PositiveFloat | tuple[PositiveFloat, ...] = 0.4
    face_bl: PositiveFloat = 2.5
    num_phases: PositiveInt = 8
    num_travels: PositiveFloat = 100.0
    wake_folder: str = "runs/wakes"

    def __post_init__(self) -> None:
        num = len(self.speeds_bl)
        if isinstance(self.diameter_bl, tuple) and len(self.diameter_bl) != num:
            raise ValueError(
                f"diameter_bl = {self.diameter_bl}: {len(self.diameter_bl)} for {num} entries of "
                "speeds_bl; give one for each, or a number for all"
            )
        names = [label["name"] for label in self.labels]
        if self.has_disc and len(set(names)) < len(names):
            raise ValueError(f"speeds_bl and diameter_bl give the flows {names}: must differ")

    @property
    def diameters_bl(self) -> tuple[float, ...]:
        """D of each stream's half disc, body lengths; 0 without one."""
        if not self.has_disc:
            return (0.0,) * len(self.speeds_bl)
        if isinstance(self.diameter_bl, tuple):
            return self.diameter_bl
        return (self.diameter_bl,) * len(self.speeds_bl)

    @property
    def labels(self) -> list[dict[str, Any]]:
        """Parameters of each flow, in order."""
        has_several = len(set(self.diameters_bl)) > 1
        return [
            {
                "name": f"{speed:g} L/T" + f", D = {diameter:g} L" * has_several,
                "stream_speed_bl": speed,
                "diameter_bl": diameter,
            }
            for speed, diameter in zip(self.speeds_bl, self.diameters_bl, strict=True)
        ]

    def draw_changes(self, flow: Tensor, key: Tensor, *, duration_T: float) -> dict[str, Tensor]:
        """Return ``stream_speeds`` ``[E, K]``, L / T: what the K changes of an episode lead to.

        ``flow`` ``[E]`` is the index of the first flow, ``key`` ``[E]`` int64 the episode's key.
        """
        if self.changes is None:
            return {}
        first = make_constant(self.speeds_bl, torch.float64, flow.device)[flow]
        return {"stream_speeds": self.changes.draw_speeds(first, key, duration_T)}


class AbstractStreamTask(AbstractTask):
    """Base of tasks in streams; places are (x, y) in L from the middle of the disc's flat side.

    Starts hold ``wake_phase`` ``[E]`` in [0, 1), ``flow_index`` ``[E]``, and what
    ``Stream.draw_changes`` returns.
    """

    @property
    @abstractmethod
    def stream(self) -> Stream:
        """The streams."""

    @property
    def max_stream_speed_bl(self) -> float:
        """Fastest of the known streams."""
        return max(self.stream.speeds_bl)

    @cached_property
    def origin(self) -> tuple[float, float]:
        """Middle of the disc's flat side, (x, y) in nodes."""
        return self.stream.face_bl * self.body_length, 0.5 * (self.domain[1] - 1)

    @cached_property
    def discs(self) -> tuple[DCylinder, ...]:
        """Half disc of each stream, all with the markers of the largest; empty without discs."""
        if not self.stream.has_disc:
            return ()
        sizes = [diameter * self.body_length for diameter in self.stream.diameters_bl]
        largest = self.skin.fit(DCylinder(diameter=max(sizes)))
        return tuple(replace(largest, diameter=size) for size in sizes)

    @property
    def disc_places(self) -> list[tuple[float, float]]:
        """Centre of area of each half disc, 2 D / (3 pi) upstream of its flat side, in nodes."""
        x, y = self.origin
        return [(x - 2.0 * disc.diameter / (3.0 * pi), y) for disc in self.discs]

    @cached_property
    def wakes(self) -> WakeBank | None:
        """Developed wakes in which episodes begin, a file for each diameter; None without discs."""
        stream, scales = self.stream, self.scales
        found: dict[int, tuple[Sequence[Tensor], Tensor]] = {}
        if not stream.has_disc:
            return None
        for diameter in dict.fromkeys(stream.diameters_bl):
            own = [flow for flow, other in enumerate(stream.diameters_bl) if other == diameter]
            recipe = WakeRecipe(
                config=_leave_alone(self.flow_config(), self.discs[own[0]]),
                position=self.disc_places[own[0]],
                heading=pi,
                speeds=tuple(scales.reference_speed * stream.speeds_bl[flow] for flow in own),
                num_phases=stream.num_phases,
                num_travels=stream.num_travels,
            )
            bank = load_wakes(recipe, stream.wake_folder)
            if len(own) == len(stream.speeds_bl):
                return bank
            each = zip(zip(*bank.populations, strict=True), bank.shedding_frequencies, strict=True)
            found |= zip(own, each, strict=True)
        wakes, frequencies = zip(*(found[flow] for flow in sorted(found)), strict=True)
        return WakeBank(
            populations=[torch.stack(grid) for grid in zip(*wakes, strict=True)],
            shedding_frequencies=torch.stack(frequencies),
        )

    @property
    def bodies(self) -> tuple[BodyConfig, ...]:
        """The fish and, if any, the largest disc."""
        return self.fish, *sorted(self.discs, key=lambda disc: disc.diameter)[-1:]

    def flow_config(self) -> FlowConfig:
        """Return the flow of the fastest stream with the fish and, if any, the largest disc."""
        stream = self.stream
        config = replace(
            super().flow_config(),
            stream_speed=self.scales.stream_speed,
            boundaries=Boundaries.make_stream(),
        )
        for disc in self.discs:
            _leave_alone(config, disc)  # raises if its markers lie too close
            x, y = self.origin
            if not (min(x, y) - 0.5 * disc.diameter >= 2.0 and x <= config.width - 3.0):
                width, height = self.domain_bl
                raise ValueError(
                    f"face_bl = {stream.face_bl}, diameter_bl = {stream.diameter_bl}: the half "
                    f"disc exceeds the domain of {width:g} L x {height:g} L; move it, reduce it, "
                    "or enlarge domain_bl"
                )
        if stream.changes is not None:
            speeds = torch.tensor(stream.changes.speeds_bl, dtype=torch.float64)
            self._check_speeds(f"stream.changes = {stream.changes}", speeds)
        return config

    def locate(self, position: Tensor) -> Tensor:
        """Return the places of positions ``[..., 2]`` in nodes."""
        x, y = self.origin  # numbers: a tensor would have to be copied to a GPU each time
        return torch.stack((position[..., 0] - x, position[..., 1] - y), -1) / self.body_length

    def frame(self, key: str, *, x_bl: tuple[float, float], aside_bl: float) -> Area:
        """Return the area of places with x in ``x_bl`` and y within ``aside_bl`` of 0."""
        (x, y), length = self.origin, self.body_length
        (near, far), aside = (x + length * end for end in x_bl), aside_bl * length
        return Area(key=key, low=(near, y - aside), high=(far, y + aside))

    def check_starts(self, starts: TensorDictBase) -> None:
        """Also check the wake phases, and changes for speeds beyond the validated range."""
        super().check_starts(starts)
        phase = starts["wake_phase"]
        if not ((phase >= 0.0) & (phase < 1.0)).all():
            raise ValueError(f"starts['wake_phase'] = {phase.tolist()}: allowed is [0, 1)")
        if self.stream.changes is not None:
            self._check_speeds("starts['stream_speeds']", starts["stream_speeds"])

    def place_(self, solver: InPlaceSolver, rows: Tensor, starts: TensorDictBase) -> None:
        """Set the stream, wake and bodies of each row."""
        self.begin_(solver, rows, starts, place_fish(starts, self.fish))

    def begin_(
        self,
        solver: InPlaceSolver,
        rows: Tensor,
        starts: Mapping[str, Tensor],
        place: tuple[Tensor, Tensor],
    ) -> None:
        """Reset stream speed, wake and bodies of the flows in ``rows`` ``[B]`` bool.

        ``starts`` hold ``flow_index`` and ``wake_phase``, ``[B]`` each, ``place`` centre of mass
        ``[B, 2]`` and heading ``[B]`` of the fish.
        """
        flow, (position, heading) = starts["flow_index"], place
        speeds = make_constant(self.stream.speeds_bl, torch.float64, rows.device)
        solver.set_stream_speed_(self.scales.reference_speed * speeds[flow], rows)
        if self.discs:
            places = make_constant(tuple(self.disc_places), torch.float32, position.device)
            position = torch.stack((position, places[flow].to(position)), 1)
            params = _make_params(self.discs, rows.device)
            solver.set_body_(1, pytree.tree_map(lambda each: each[flow], params), rows)
            heading = torch.stack((heading, torch.full_like(heading, pi)), 1)
        solver.reset_(rows, position, heading, velocity=(1.0, 0.0))
        if self.wakes is not None:
            # of a GPU the host would have to wait to see which rows begin: every row takes a wake
            own = slice(None) if rows.is_cuda and self.levels == 1 else rows
            f = self.wakes.take(flow[own], starts["wake_phase"][own])
            solver.set_populations_(_spread(f, solver.config), rows)
            solver.join_stream_(rows)

    def prepare_(self, solver: InPlaceSolver, starts: TensorDictBase) -> None:
        """Begin the changes of the stream that fell due within the last action."""
        changes = self.stream.changes
        if changes is None or not starts["stream_speeds"].shape[1]:
            return
        speeds, age = starts["stream_speeds"], solver.body.age[:, None]
        times_T = tuple(changes.list_times(speeds.shape[1]))
        times = make_constant(times_T, speeds.dtype, speeds.device) * self.scales.period
        num, num_before = ((times <= now + 1e-6).sum(1) for now in (age, age - self.n_substeps))
        target = speeds.gather(1, (num[:, None] - 1).clamp_min(0))[:, 0]
        solver.set_stream_speed_(
            self.scales.reference_speed * target,
            num > num_before,
            num_steps=round(changes.ramp_T * self.scales.period),
        )

    def measure_stream(self, solver: InPlaceSolver, first: Tensor) -> dict[str, Tensor]:
        """Return ``flow_index`` ``[B]``, and ``stream_speed`` ``[B]`` in L / T if it changes.

        ``flow_index`` is the flow behind the same disc whose speed is nearest at present; ``first``
        ``[B]`` is the flow at the start.
        """
        if self.stream.changes is None:
            return {"flow_index": first.clone()}
        speed = solver.stream_speed / self.scales.reference_speed
        flows = (self.stream.speeds_bl, self.stream.diameters_bl)
        known, sizes = make_constant(flows, speed.dtype, speed.device)
        difference = (speed[:, None] - known).abs()
        is_other = sizes != sizes[first][:, None]
        return {
            "flow_index": difference.masked_fill(is_other, inf).argmin(-1),
            "stream_speed": speed,
        }

    def _check_speeds(self, name: str, speeds: Tensor) -> None:
        """Raise ValueError unless speeds (L / T) are positive and of a validated Mach number."""
        fastest = MAX_WALL_SPEED / self.scales.reference_speed
        if not ((speeds > 0.0) & (speeds <= fastest * (1.0 + 1e-9))).all():
            low, high = speeds.min().item(), speeds.max().item()
            raise ValueError(
                f"{name} reaches from {low:g} to {high:g} L/T: allowed are speeds above 0 and up "
                f"to {floor(1e3 * fastest) / 1e3:g} L/T, which is {MAX_WALL_SPEED} nodes per step "
                f"(Mach {MAX_WALL_SPEED * 3**0.5:.2f}); lower the speeds, or max_wall_speed"
            )


def _leave_alone(config: FlowConfig, disc: DCylinder) -> FlowConfig:
    """Return a flow with the disc, its second body, as the only one, and with the disc's patch."""
    kept = [patch for patch in config.patches if patch.bodies is None or 1 in patch.bodies]
    patches = tuple(replace(patch, bodies=None) for patch in kept)
    return replace(config, bodies=(disc,), patches=patches)


def _spread(wake: Sequence[Tensor], config: FlowConfig) -> list[Tensor | None]:
    """Return a wake of the disc alone for all grids, None where the fish has its own patch."""
    own = iter(wake)
    f: list[Tensor | None] = [next(own)]
    for patch in config.refined:
        f += [next(own) if 1 in patch.numbers else None for _ in range(config.levels - 1)]
    return f


@cache
def _make_params(discs: tuple[DCylinder, ...], device: torch.device) -> BodyParams:
    """Return the parameters ``[n, ...]`` of half discs."""
    params = [disc.make_params(device) for disc in discs]
    joined: BodyParams = pytree.tree_map(lambda *each: torch.cat(each), *params)
    return joined
