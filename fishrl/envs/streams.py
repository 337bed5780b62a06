"""Streams of several speeds, with or without a half disc."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import torch
from torch import Tensor

from fishrl.bounds import bounded, check_bounds
from fishrl.envs.protocol import Solver
from fishrl.envs.wakes import WakeBank, WakeRecipe, load_wakes
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.outline import DCylinder
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge
from fishrl.physics.flow import FlowConfig
from fishrl.physics.units import Scales


@dataclass(frozen=True, kw_only=True)
class Stream:
    """Streams along +x that differ in speed only.

    Inflow and sides move with the stream; the outflow is transparent to plane sound waves. The flat
    side of the half disc faces downstream as in Liao et al. 2003 (the paper does not specify it).

    Args:
        speeds_bl: stream speeds, L / T; by default the paper's conditions I, II and III.
        has_disc: include the half disc; positions refer to its location in a free stream too.
        diameter_bl: D of the half disc, body lengths.
        face_bl: distance of its flat side from the inflow.
        num_phases: wake snapshots per shedding period from which episodes start.
        num_travels: development time of a wake, D / U; see ``wakes.WakeRecipe``.
        wake_folder: cache of developed wakes.
    """

    speeds_bl: tuple[float, ...] = bounded((1.0, 1.25, 1.5), greater=0, entries=1)
    has_disc: bool = True
    diameter_bl: float = bounded(0.4, greater=0)
    face_bl: float = bounded(2.5, greater=0)
    num_phases: int = bounded(8, least=1)
    num_travels: float = bounded(100.0, greater=0)
    wake_folder: str = "runs/wakes"

    def __post_init__(self) -> None:
        speeds = tuple(float(speed) for speed in self.speeds_bl)
        object.__setattr__(self, "speeds_bl", speeds)
        check_bounds(self)

    @property
    def labels(self) -> list[dict[str, Any]]:
        """Parameters of each flow, in order."""
        diameter = self.diameter_bl if self.has_disc else 0.0
        return [
            {"name": f"{speed:g} L/T", "stream_speed_bl": speed, "diameter_bl": diameter}
            for speed in self.speeds_bl
        ]

    def make_config(self, fish: Fish, scales: Scales, domain_bl: tuple[float, float]) -> FlowConfig:
        """Return the flow of the fastest stream with the fish and, if any, the half disc."""
        width, height = (round(size * scales.body_length) for size in domain_bl)
        moving = NonEquilibrium(velocity=(1.0, 0.0))
        disc = [DCylinder(diameter=self.diameter_bl * scales.body_length)] if self.has_disc else []
        config = FlowConfig(
            width=width,
            height=height,
            tau=scales.tau,
            stream_speed=max(self.speeds_bl) * scales.reference_speed,
            bodies=(fish, *disc),
            boundaries=Boundaries(left=moving, right=OpenEdge(), bottom=moving, top=moving),
        )
        x, y = self.find_origin(config, scales)
        radius = 0.5 * self.diameter_bl * scales.body_length
        if self.has_disc and not (min(x, y) - radius >= 2.0 and x <= width - 3.0):
            raise ValueError(
                f"face_bl = {self.face_bl}, diameter_bl = {self.diameter_bl}: the half disc "
                f"exceeds the domain of {domain_bl[0]:g} L x {domain_bl[1]:g} L; move it, "
                "reduce it, or enlarge domain_bl"
            )
        return config

    def find_origin(self, config: FlowConfig, scales: Scales) -> tuple[float, float]:
        """Return the middle of the disc's flat side (x, y) in nodes."""
        return self.face_bl * scales.body_length, 0.5 * (config.height - 1)

    def find_disc(self, config: FlowConfig, scales: Scales) -> tuple[float, float]:
        """Return the half disc's centre of area, 2 D / (3 pi) upstream of its flat side."""
        x, y = self.find_origin(config, scales)
        return x - 2.0 * self.diameter_bl * scales.body_length / (3.0 * pi), y

    def load_wakes(self, config: FlowConfig, scales: Scales) -> WakeBank:
        """Return the developed wakes of all flows, from their file if it exists."""
        recipe = WakeRecipe(
            config=replace(config, bodies=config.bodies[1:]),
            position=self.find_disc(config, scales),
            heading=pi,
            speeds=tuple(scales.reference_speed * speed for speed in self.speeds_bl),
            num_phases=self.num_phases,
            num_travels=self.num_travels,
        )
        return load_wakes(recipe, self.wake_folder)

    def begin_(
        self,
        solver: Solver,
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
            disc = torch.tensor(self.find_disc(solver.config, scales)).to(position)
            position = torch.stack((position, disc.expand_as(position)), 1)
            heading = torch.stack((heading, torch.full_like(heading, pi)), 1)
        solver.reset_(rows, position, heading, velocity=(1.0, 0.0))
        if wakes is not None:
            solver.set_populations_(wakes.take(flow[rows], starts["wake_phase"][rows]), rows)
