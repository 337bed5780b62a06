"""Streams of several speeds, which may change within an episode, with or without half discs."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, cached_property
from math import floor, inf, pi
from typing import Annotated, Any

import torch
from pydantic import Field, PositiveFloat, PositiveInt
from tensordict import TensorDictBase
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.envs.changes import StreamChanges
from fishrl.envs.scene import Area, Panel, Series
from fishrl.envs.task import AbstractTask
from fishrl.envs.wakes import WakeBank, WakeRecipe, load_wakes
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.outline import BodyParams, DCylinder
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import Coupling, FlowConfig
from fishrl.physics.units import MAX_WALL_SPEED, Scales
from fishrl.settings import Settings


class Stream(Settings):
    """Streams along +x that differ in speed and in the diameter of their half disc.

    Inflow and sides move with the stream; the outflow is transparent to plane sound waves. The flat
    side of the half disc faces downstream as in Liao et al. 2003 (the paper does not specify it).

    Args:
        speeds_bl: stream speeds, L / T; by default the paper's conditions I, II and III.
        changes: changes of the speed within an episode, which begins at one of ``speeds_bl``; None
            for steady streams.
        has_disc: include the half disc; positions refer to its location in a free stream too.
        diameter_bl: D of the half disc, body lengths, one for all streams or one for each. Discs of
            different D have as many markers as the largest, on which they lie a node apart.
        face_bl: distance of its flat side from the inflow.
        num_phases: wake snapshots per shedding period from which episodes start.
        num_travels: development time of a wake, D / U; see ``wakes.WakeRecipe``.
        wake_folder: cache of developed wakes.
    """

    speeds_bl: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = (1.0, 1.25, 1.5)
    changes: StreamChanges | None = None
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

    def make_config(
        self,
        fish: Fish,
        scales: Scales,
        domain_bl: tuple[float, float],
        coupling: Coupling = Coupling.IMPLICIT,
    ) -> FlowConfig:
        """Return the flow of the fastest stream with the fish and, if any, the largest disc."""
        width, height = (round(size * scales.body_length) for size in domain_bl)
        moving = NonEquilibrium(velocity=(1.0, 0.0))
        diameter = max(self.diameters_bl) * scales.body_length
        discs = _make_discs(self._measure_discs(scales), coupling) if self.has_disc else ()
        largest = sorted(discs, key=lambda disc: disc.diameter)[-1:]
        config = FlowConfig(
            width=width,
            height=height,
            tau=scales.tau,
            stream_speed=max(self.speeds_bl) * scales.reference_speed,
            bodies=(fish, *largest),
            boundaries=Boundaries(left=moving, right=OpenEdge(), bottom=moving, top=moving),
            coupling=coupling,
        )
        for disc in discs:
            replace(config, bodies=(disc,))  # raises if its markers lie too close
        x, y = self.find_origin(config, scales)
        if self.has_disc and not (min(x, y) - 0.5 * diameter >= 2.0 and x <= width - 3.0):
            raise ValueError(
                f"face_bl = {self.face_bl}, diameter_bl = {self.diameter_bl}: the half disc "
                f"exceeds the domain of {domain_bl[0]:g} L x {domain_bl[1]:g} L; move it, "
                "reduce it, or enlarge domain_bl"
            )
        if self.changes is not None:
            speeds = torch.tensor(self.changes.range_bl, dtype=torch.float64)
            _check_speeds(f"stream.changes = {self.changes}", speeds, scales)
        return config

    def find_origin(self, config: FlowConfig, scales: Scales) -> tuple[float, float]:
        """Return the middle of the disc's flat side (x, y) in nodes."""
        return self.face_bl * scales.body_length, 0.5 * (config.height - 1)

    def find_discs(self, config: FlowConfig, scales: Scales) -> list[tuple[float, float]]:
        """Return each half disc's centre of area, 2 D / (3 pi) upstream of its flat side."""
        x, y = self.find_origin(config, scales)
        return [(x - 2.0 * size / (3.0 * pi), y) for size in self._measure_discs(scales)]

    def _measure_discs(self, scales: Scales) -> tuple[float, ...]:
        """Return the diameter of each half disc in nodes."""
        return tuple(diameter * scales.body_length for diameter in self.diameters_bl)

    def load_wakes(self, config: FlowConfig, scales: Scales) -> WakeBank:
        """Return the developed wakes of all flows, from the file of each diameter if it exists."""
        discs = _make_discs(self._measure_discs(scales), config.coupling)
        places = self.find_discs(config, scales)
        wakes: dict[int, tuple[Tensor, Tensor]] = {}
        for diameter in dict.fromkeys(self.diameters_bl):
            own = [flow for flow, other in enumerate(self.diameters_bl) if other == diameter]
            recipe = WakeRecipe(
                config=replace(config, bodies=(discs[own[0]],)),
                position=places[own[0]],
                heading=pi,
                speeds=tuple(scales.reference_speed * self.speeds_bl[flow] for flow in own),
                num_phases=self.num_phases,
                num_travels=self.num_travels,
            )
            bank = load_wakes(recipe, self.wake_folder)
            if len(own) == len(self.speeds_bl):
                return bank
            each = zip(bank.populations, bank.shedding_frequencies, strict=True)
            wakes |= zip(own, each, strict=True)
        populations, frequencies = zip(*(wakes[flow] for flow in sorted(wakes)), strict=True)
        return WakeBank(
            populations=torch.stack(populations), shedding_frequencies=torch.stack(frequencies)
        )

    def draw_changes(self, flow: Tensor, key: Tensor, *, duration_T: float) -> dict[str, Tensor]:
        """Return ``stream_speeds`` ``[E, K]``, L / T: what the K changes of an episode lead to.

        ``flow`` ``[E]`` is the index of the first flow, ``key`` ``[E]`` int64 the episode's key.
        """
        if self.changes is None:
            return {}
        first = torch.tensor(self.speeds_bl, dtype=torch.float64, device=flow.device)[flow]
        num = self.changes.count(duration_T)
        return {"stream_speeds": self.changes.draw_speeds(first, key, num)}

    def check_starts(self, starts: TensorDictBase, scales: Scales) -> None:
        """Raise ValueError for changes to speeds beyond the validated range."""
        if self.changes is not None:
            _check_speeds("starts['stream_speeds']", starts["stream_speeds"], scales)

    def change_(
        self, solver: InPlaceSolver, starts: TensorDictBase, *, scales: Scales, num_steps: int
    ) -> None:
        """Begin the changes that fell due within the last ``num_steps``."""
        if self.changes is None or not starts["stream_speeds"].shape[1]:
            return
        speeds, age = starts["stream_speeds"], solver.body.age[:, None]
        times = speeds.new_tensor(self.changes.list_times(speeds.shape[1])) * scales.period
        num, num_before = ((times <= now + 1e-6).sum(1) for now in (age, age - num_steps))
        target = speeds.gather(1, (num[:, None] - 1).clamp_min(0))[:, 0]
        solver.set_stream_speed_(
            scales.reference_speed * target,
            num > num_before,
            num_steps=round(self.changes.ramp_T * scales.period),
        )

    def measure(self, solver: InPlaceSolver, first: Tensor, scales: Scales) -> dict[str, Tensor]:
        """Return ``flow_index`` ``[B]``, and ``stream_speed`` ``[B]`` in L / T if it changes.

        ``flow_index`` is the flow behind the same disc whose speed is nearest at present; ``first``
        ``[B]`` is the flow at the start.
        """
        if self.changes is None:
            return {"flow_index": first.clone()}
        speed = solver.stream_speed / scales.reference_speed
        flows = (self.speeds_bl, self.diameters_bl)
        known, sizes = torch.tensor(flows, dtype=speed.dtype, device=speed.device)
        difference = (speed[:, None] - known).abs()
        is_other = sizes != sizes[first][:, None]
        return {
            "flow_index": difference.masked_fill(is_other, inf).argmin(-1),
            "stream_speed": speed,
        }

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return the entries of ``measure`` that only a changing stream has."""
        return {} if self.changes is None else {"stream_speed": now["stream_speed"]}

    @property
    def panels(self) -> tuple[Panel, ...]:
        """A plot of the present speed, if it changes."""
        series = (Series(key="stream_speed", label="speed"),)
        return () if self.changes is None else (Panel(name="stream speed [L/T]", series=series),)

    def begin_(
        self,
        solver: InPlaceSolver,
        rows: Tensor,
        starts: Mapping[str, Tensor],
        place: tuple[Tensor, Tensor],
        *,
        scales: Scales,
        wakes: WakeBank | None,
    ) -> None:
        """Reset stream speed, wake and bodies of the flows in ``rows`` ``[B]`` bool.

        ``starts`` hold ``flow_index`` and ``wake_phase``, ``[B]`` each, ``place`` centre of mass
        ``[B, 2]`` and heading ``[B]`` of the fish; without ``wakes`` the stream is undisturbed.
        """
        flow, (position, heading) = starts["flow_index"], place
        speeds = torch.tensor(self.speeds_bl, dtype=torch.float64, device=rows.device)
        solver.set_stream_speed_(scales.reference_speed * speeds[flow], rows)
        if self.has_disc:
            places = torch.tensor(self.find_discs(solver.config, scales)).to(position)
            position = torch.stack((position, places[flow]), 1)
            sizes, coupling = self._measure_discs(scales), solver.config.coupling
            params = _draw_discs(sizes, coupling, rows.device)
            solver.set_body_(1, pytree.tree_map(lambda each: each[flow], params), rows)
            heading = torch.stack((heading, torch.full_like(heading, pi)), 1)
        solver.reset_(rows, position, heading, velocity=(1.0, 0.0))
        if wakes is not None:
            solver.set_populations_(wakes.take(flow[rows], starts["wake_phase"][rows]), rows)


class AbstractStreamTask(AbstractTask):
    """Base of tasks in streams; places are (x, y) in L from the middle of the disc's flat side."""

    @property
    @abstractmethod
    def stream(self) -> Stream:
        """The streams."""

    @property
    def max_stream_speed_bl(self) -> float:
        """Fastest of the known streams."""
        return max(self.stream.speeds_bl)

    def flow_config(self) -> FlowConfig:
        """Return the flow with the fastest stream."""
        return self.stream.make_config(self.fish, self.scales, self.domain_bl, self.coupling)

    @cached_property
    def origin(self) -> tuple[float, float]:
        """Middle of the disc's flat side, (x, y) in nodes."""
        return self.stream.find_origin(self.flow_config(), self.scales)

    @cached_property
    def wakes(self) -> WakeBank | None:
        """Developed wakes in which episodes begin; None in free streams."""
        if not self.stream.has_disc:
            return None
        return self.stream.load_wakes(self.flow_config(), self.scales)

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
        """Also check the wake phases."""
        super().check_starts(starts)
        phase = starts["wake_phase"]
        if not ((phase >= 0.0) & (phase < 1.0)).all():
            raise ValueError(f"starts['wake_phase'] = {phase.tolist()}: allowed is [0, 1)")


@cache
def _make_discs(sizes: tuple[float, ...], coupling: Coupling) -> tuple[DCylinder, ...]:
    """Return half discs of these diameters in nodes, all with the markers of the largest."""
    largest = DCylinder(diameter=max(sizes), **coupling.body_settings)
    return tuple(replace(largest, diameter=size) for size in sizes)


@cache
def _draw_discs(sizes: tuple[float, ...], coupling: Coupling, device: torch.device) -> BodyParams:
    """Return the parameters ``[n, ...]`` of these half discs."""
    params = [disc.make_params(device) for disc in _make_discs(sizes, coupling)]
    joined: BodyParams = pytree.tree_map(lambda *each: torch.cat(each), *params)
    return joined


def _check_speeds(name: str, speeds: Tensor, scales: Scales) -> None:
    """Raise ValueError unless speeds (L / T) are positive and within the validated Mach number."""
    fastest = MAX_WALL_SPEED / scales.reference_speed
    if not ((speeds > 0.0) & (speeds <= fastest * (1.0 + 1e-9))).all():
        low, high = speeds.min().item(), speeds.max().item()
        raise ValueError(
            f"{name} reaches from {low:g} to {high:g} L/T: allowed are speeds above 0 and up to "
            f"{floor(1e3 * fastest) / 1e3:g} L/T, which is {MAX_WALL_SPEED} nodes per step (Mach "
            f"{MAX_WALL_SPEED * 3**0.5:.2f}); lower the speeds, or max_wall_speed"
        )
