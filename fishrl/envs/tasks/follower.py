"""Follower: swim behind a fish with as little work as possible."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from math import inf, pi
from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field, PositiveFloat
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.constants import make_constant
from fishrl.envs.control import AbstractControlTask, Bend, ContinuousFrequency, Control
from fishrl.envs.control.control import Rising
from fishrl.envs.extensions import HasScene
from fishrl.envs.scene import Scene
from fishrl.envs.sense import Sense
from fishrl.envs.sensors import compute_clearance, compute_gap, wrap_angle
from fishrl.envs.starts import check_fit, place_fish, place_outline
from fishrl.envs.streams import AbstractStreamTask, Stream
from fishrl.envs.task import AbstractTask
from fishrl.physics.bodies.motion import Driven
from fishrl.physics.bodies.outline import BodyConfig
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig, Sponge
from fishrl.physics.levels.patch import RING, Patch


class Follower(AbstractControlTask, AbstractStreamTask, HasScene):
    """Hold a place in the wake of a leader by bending the midline and choosing the tail beat.

    The leader beats once per T and is held in place, in a stream along +x of the speed at which it
    would swim: the mean force on it vanishes. The follower is free; only the water turns it.

    Positions are (x, y) of the follower's centre of mass behind the rear end of the leader, in body
    lengths. Actions, each T / 2: the bend, the frequency and, with an ``amplitude_range``, the
    amplitude. An episode terminates when the follower leaves its range, touches the leader or comes
    near an edge.

    The reward is the efficiency of the interval as in Verma, Novati & Koumoutsakos 2018. They count
    thrust times speed as useful work; we count ``cost_alone`` for each body length through the
    water, so that 0.5 is as efficient as alone.

    Parameters follow the tasks twoFish and cylFollow of CubismUP 2D (CSE-lab, ETH Zürich).

    ``stream_speed_bl``, at which no mean force acts on a held leader, and ``cost_alone`` are those
    of the sharp skin at L = 32; the immersed boundary needs 0.35 and 0.11.

    Args:
        leader: fish, or none, for comparison with a fish alone. (``KarmanGait`` with
            ``control=Bend()`` has a fish that turns itself behind a half disc.)
        stream_speed_bl: speed of the stream, L / T.
        control: continuous bend and tail beat; the beat may have an ``amplitude_range``.
        cost_alone: work of the fish alone for 1 L through the water, rho L^4 / T^2.
        leader_x_bl: distance of the rear end of the leader from the inflow.
        start_x_bl: range of the initial x.
        start_y_bl: the same along y.
        start_degrees: largest angle of the initial heading from upstream.
        range_bl: least and largest x.
        aside_bl: largest distance from the centreline of the leader.
        contact_bl: gap to the leader that counts as contact; below three nodes or so the delta
            kernels of both overlap.
    """

    num_draws: ClassVar[int] = 4
    former: ClassVar[Mapping[str, str]] = {
        **AbstractTask.former,
        "turn_degrees": "give control.bend_bl",
        "frequency_range": "give control.beat.frequency_range",
        "amplitude_range": "give control.beat.amplitude_range",
    }

    body_length: int = 32
    reynolds: float = 5000.0
    max_wall_speed: float = 0.15
    domain_bl: tuple[float, float] = (6.0, 3.0)
    wall_margin_bl: float = 0.16
    time_limit: int = 200
    control_interval_T: float = 0.5
    checks_per_action: int = 16
    leader: Literal["fish", "none"] = "fish"
    stream_speed_bl: PositiveFloat = 0.49
    control: Control = Bend(
        bend_bl=0.105, response_T=0.25, beat=ContinuousFrequency(frequency_range=(0.7, 1.35))
    )
    cost_alone: PositiveFloat = 0.05
    leader_x_bl: PositiveFloat = 1.75
    start_x_bl: tuple[float, float] = (1.0, 1.5)
    start_y_bl: tuple[float, float] = (-0.25, 0.25)
    start_degrees: Annotated[float, Field(ge=0, le=180)] = 20.0
    range_bl: Annotated[tuple[float, float], Rising] = (0.5, 3.0)
    aside_bl: PositiveFloat = 1.0
    contact_bl: PositiveFloat = 0.1

    def __post_init__(self) -> None:
        if self.action_bounds is None:
            raise ValueError("control: a follower needs continuous actions, such as Bend(beat=...)")
        for name in ("start_x_bl", "start_y_bl"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} = {(low, high)}: give the least, then the largest")
        super().__post_init__()
        corners = torch.cartesian_prod(*[torch.linspace(0.0, 1.0, 3).double()] * 3)
        self.check_starts(self.starts_from(torch.nn.functional.pad(corners, (0, 1))))

    @property
    def max_frequency(self) -> float:
        """Highest frequency of follower and leader."""
        return max(1.0, super().max_frequency)

    @cached_property
    def stream(self) -> Stream:
        """The stream; places refer to the rear end of the leader."""
        speeds, x = (self.stream_speed_bl,), self.leader_x_bl
        return Stream(speeds_bl=speeds, has_disc=False, face_bl=x)

    def list_patches(self) -> tuple[Patch, ...]:
        """Return one patch that holds the leader and the follower in its range."""
        if self.leader == "none":
            return ()
        reach = 0.75 + (self.travel + self.skin.margin + RING + 1) / self.body_length
        x_bl, aside = (-1.25, self.range_bl[1] + reach), self.aside_bl + reach
        box = self.frame("patch", x_bl=x_bl, aside_bl=aside)
        return (Patch.between(box.low, box.high),)

    @property
    def bodies(self) -> tuple[BodyConfig, ...]:
        """The follower and, if any, the leader."""
        leader = replace(self.fish, motion=Driven())
        return (self.fish, leader) if self.leader == "fish" else (self.fish,)

    def flow_config(self) -> FlowConfig:
        """Return the stream with the follower and, if any, the leader."""
        # the first vortices would grow at the outflow
        sponge = Sponge(length=self.body_length // 2)
        return replace(super().flow_config(), sponges=(sponge,))

    @cached_property
    def leader_start(self) -> TensorDict:
        """Nose and heading of the leader, ``[1]``, as in ``starts_from``."""
        x, y = self.origin
        head = torch.tensor([[x - self.body_length, y]], dtype=torch.float64)
        return TensorDict({"head": head, "heading": torch.full_like(head[:, 0], pi)}, [1])

    @property
    def contact(self) -> float:
        """Gap that counts as contact, nodes."""
        return self.contact_bl * self.body_length

    def starts_from(self, uniform: Tensor) -> TensorDict:
        """Draw position and heading, and the phase that every start in a stream has."""
        ranges = (self.start_x_bl, self.start_y_bl, (-self.start_degrees, self.start_degrees))
        low, high = make_constant(ranges, uniform.dtype, uniform.device).T
        x, y, angle = (low + uniform[:, :3] * (high - low)).unbind(-1)
        heading = pi + angle.deg2rad()
        ahead = torch.stack((heading.cos(), heading.sin()), -1)
        origin = make_constant(self.origin, uniform.dtype, uniform.device)
        centre = origin + self.body_length * torch.stack((x, y), -1)
        starts = {
            "head": centre + self.fish.centre * ahead,
            "heading": heading,
            "wake_phase": uniform[:, 3].clone(),
        }
        return TensorDict(starts, uniform.shape[:1], device=uniform.device)

    def check_starts(self, starts: TensorDictBase) -> None:
        """Also check that the follower is within its range and apart from the leader."""
        super().check_starts(starts)
        place = self.locate(place_fish(starts, self.fish)[0])
        gap, config = torch.full_like(place[:, 0], inf), self.flow_config()
        for leader in config.bodies[1:]:
            check_fit(self.leader_start, leader, config, margin=self.wall_margin)
            other = place_outline(self.leader_start, leader).to(place)
            gap = compute_gap(place_outline(starts, self.fish), other)
        is_wrong = self._has_left(place) | ~(gap >= self.contact)
        if is_wrong.any():
            i = int(is_wrong.int().argmax())
            raise ValueError(
                f"start {i}: {place[i].tolist()} L behind the leader, {gap[i]:.3g} nodes from it: "
                f"allowed is x in {self.range_bl} and |y| up to {self.aside_bl} L with a gap of "
                f"{self.contact:.3g} nodes; move it (start_x_bl, start_y_bl)"
            )

    def place_(self, solver: InPlaceSolver, rows: Tensor, starts: TensorDictBase) -> None:
        """Set the stream and the bodies of each row."""
        position, heading = place_fish(starts, self.fish)
        if self.leader == "fish":
            centre, angle = place_fish(self.leader_start.to(starts.device), self.fish)
            position = torch.stack((position, centre.expand_as(position)), 1)
            heading = torch.stack((heading, angle.expand_as(heading)), 1)
        draws = {"flow_index": rows.long() * 0, "wake_phase": starts["wake_phase"]}
        self.begin_(solver, rows, draws, (position, heading))

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Measure position, motion and work of the follower, and the gap to the leader."""
        body, markers, scales = solver.body, solver.markers(), self.scales
        gap, lead = torch.full_like(body.phase, inf), torch.zeros_like(body.phase)
        for index in range(1, len(solver.bodies)):
            gap = compute_gap(markers, solver.markers(index))
        if self.leader == "fish":
            lead = solver.bodies[1].phase
        unit = (scales.reference_speed * self.body_length) ** 2
        now = {
            "place": self.locate(body.position),
            "heading": wrap_angle(body.heading + body.internal_angle - pi),
            "velocity": body.velocity / scales.reference_speed,
            "spin": body.angular_velocity * scales.period,
            "phase": body.phase.clone(),
            "phase_ahead": body.phase - lead,
            "age": body.age.clone(),
            "gap": gap,
            "clearance": compute_clearance(markers, solver.config),
            "work": body.work / unit,
            "positive_work": body.positive_work / unit,
        }
        return TensorDict(now, starts.batch_size, device=starts.device)

    def begin(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Start without earlier actions."""
        actions = now["place"].new_zeros(*now.shape, 2, self.num_actions)
        return super().begin(now) | {"actions": actions}

    def remember(
        self, before: TensorDictBase, action: Tensor, now: TensorDictBase
    ) -> dict[str, Tensor]:
        """Keep the last two actions, each number in [-1, 1]."""
        low, high = make_constant(self.action_bounds, torch.float32, action.device).to(action).T
        share = 2.0 * (action - low) / (high - low) - 1.0
        return {"actions": torch.stack((before["actions"][:, 1], share), 1)}

    @property
    def senses(self) -> tuple[Sense, ...]:
        """Place, heading, own motion and the last two actions."""

        def read_wave(phase: Tensor) -> Tensor:
            return torch.stack((phase.sin(), phase.cos()), -1)

        wave = ("sine of the phase", "cosine of the phase")
        of_actions = None
        with suppress(ValueError):  # of a control that names none; then ``mirror`` raises it
            of_actions = tuple(sign * n for n, sign in enumerate(self.mirrored_actions, 1))
        actions = tuple(f"{name} (in [-1, 1])" for name in self.action_names)
        return (
            Sense("place", ("x [L]", "y [L]"), lambda now: now["place"], (1, -2)),
            Sense("heading", ("from upstream [rad]",), lambda now: now["heading"][:, None], (-1,)),
            Sense("tail beat", wave, lambda now: read_wave(now["phase"]), (-1, -2)),
            Sense(
                "beat relative to the leader",
                wave,
                lambda now: read_wave(now["phase_ahead"]),
                (1, 2) if self.leader == "fish" else (-1, -2),
            ),
            Sense("velocity", ("x [L/T]", "y [L/T]"), lambda now: now["velocity"], (1, -2)),
            Sense(
                "yaw rate", ("counter-clockwise [rad/T]",), lambda now: now["spin"][:, None], (-1,)
            ),
            Sense("action before last", actions, lambda now: now["actions"][:, 0], of_actions),
            Sense("last action", actions, lambda now: now["actions"][:, 1], of_actions),
        )

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        """Return the efficiency of the interval, or the penalty for a failure.

        Terms:
            efficiency: E / (E + max(W, 0)), with E = ``cost_alone`` · max(s, 0), s the way through
                the water [L] and W the work of the muscles [ρ L⁴/T²]; 0 after a failure.
            failure: −10 if the episode terminates, 0 otherwise.
        """
        swum = self._measure_way(now) - self._measure_way(before)
        useful = self.cost_alone * swum.clamp_min(0.0)
        work = (now["work"] - before["work"]).clamp_min(0.0)
        efficiency = useful / (useful + work).clamp_min(1e-12)
        has_failed = self.is_terminated(now)
        return {
            "efficiency": efficiency.masked_fill(has_failed, 0.0),
            "failure": -10.0 * has_failed.double(),
        }

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return whether the follower has left its range, or touches an edge or the leader."""
        touches: Tensor = (now["clearance"] < self.wall_margin) | (now["gap"] < self.contact)
        return touches | self._has_left(now["place"])

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return position, distance through the water, work, positive work and contact."""
        names = ("place", "heading", "work", "positive_work")
        return {
            **{name: now[name] for name in names},
            "way": self._measure_way(now),
            "contact": now["gap"] < self.contact,
        }

    def name_endings(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Tell whether the follower touched something or left its range."""
        return {
            "touched the leader": now["gap"] < self.contact,
            "hit an edge": now["clearance"] < self.wall_margin,
            "left its range": self._has_left(now["place"]),
        }

    def add_to_scene(self, scene: Scene) -> Scene:
        """Add the range of the centre of mass."""
        area = self.frame("range", x_bl=self.range_bl, aside_bl=self.aside_bl)
        return scene.extend(areas=(area,))

    def _measure_way(self, now: TensorDictBase) -> Tensor:
        """Return how far the follower has swum through the water, L, up to a constant."""
        way: Tensor = self.stream_speed_bl * now["age"] / self.scales.period - now["place"][:, 0]
        return way

    def _has_left(self, place: Tensor) -> Tensor:
        x, y = place.unbind(-1)
        return (x < self.range_bl[0]) | (x > self.range_bl[1]) | (y.abs() > self.aside_bl)
