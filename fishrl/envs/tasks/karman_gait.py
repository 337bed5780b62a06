"""Kármán gait, the paper's second task: hold station in the wake of a half disc."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from math import pi
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.command import Command
from fishrl.envs.constants import make_constant
from fishrl.envs.control import AbstractControlTask
from fishrl.envs.extensions import HasFlowLabels, HasScene
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.scene import Panel, Scene, Series
from fishrl.envs.sense import Sense
from fishrl.envs.senses import DEFAULT_SENSES, SenseName, list_senses, measure_own_motion
from fishrl.envs.sensors import compute_clearance, wrap_angle
from fishrl.envs.stations import SafeArea, StationReward
from fishrl.envs.steering import PIDSteering, Steering
from fishrl.envs.streams import AbstractStreamTask, Stream
from fishrl.envs.views import describe_flow_label, describe_lateral_line, find_shown_feature
from fishrl.envs.wake_patches import WakePatches, place_patches
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.lattice import MAX_IMPOSED_SPEED
from fishrl.physics.levels.patch import Patch
from fishrl.physics.units import MAX_WALL_SPEED


class KarmanGait(AbstractControlTask, AbstractStreamTask, HasFlowLabels, HasScene):
    """Hold station behind a half disc, or in a free stream, by choosing the tail-beat frequency.

    Positions are of the nose relative to the middle of the disc's flat side, x downstream, in body
    lengths. The policy observes the senses that ``observes`` lists, by default place, drift, mean
    velocity of the water at the lateral line, and tail beat. ``control`` defines the actions;
    ``steering`` turns the fish unless they do, or bend it. An episode starts at a random phase of a
    developed wake and terminates in the danger area or at an edge.

    Also reported: ``lateral_line``, the true ``flow_index`` (of a changing stream the nearest known
    speed, and ``stream_speed`` in L / T), gear, frequency, heading, angle of attack (from upstream,
    radians), and the work done so far by all, pushing and lateral forces, in rho L^2 (L / T)^2.

    Args:
        stream: the flows.
        start_flows: indices of the flows in which episodes take place, drawn uniformly.
        steering: heading controller; not used if actions turn or bend the fish.
        start_x_bl: range of the initial nose position.
        start_y_bl: the same along y.
        reads_flow_class: select the row of frequencies by ``flow_class``, which a transform writes,
            instead of by the true flow.
        observes: what the policy observes, in this order, see ``senses.list_senses``; the label is
            that of a ``transforms.FlowLabelTransform``. A name may be repeated.
        lateral_line: the neuromasts.
        safe_area: area outside which episodes terminate.
        reward_terms: weights of the reward.
    """

    num_draws: ClassVar[int] = 5

    body_length: int = 40
    reynolds: float = 500.0
    max_wall_speed: float = 0.1
    wall_margin_bl: float = 0.25
    num_stacked: int = 4
    time_limit: int = 404
    control_interval_T: float = 0.25
    checks_per_action: int = 7
    stream: Stream = Stream()
    start_flows: tuple[int, ...] = (0, 1, 2)
    steering: Steering = PIDSteering()
    start_x_bl: tuple[float, float] = (1.5, 2.0)
    start_y_bl: tuple[float, float] = (-0.1, 0.1)
    reads_flow_class: bool = False
    observes: tuple[SenseName, ...] = DEFAULT_SENSES
    lateral_line: LateralLine = LateralLine()
    safe_area: SafeArea = SafeArea()
    reward_terms: StationReward = StationReward()

    def __post_init__(self) -> None:
        if not self.n_obs:
            raise ValueError(f"observes = {self.observes}: name a sense other than flow_label")
        num = self.num_flows
        if not self.start_flows or not all(0 <= i < num for i in self.start_flows):
            raise ValueError(
                f"start_flows = {self.start_flows}: give one or more of the indices 0 to {num - 1}"
            )
        super().__post_init__()
        if not self.steers:
            self.check_turn("steering", self.steering.largest_turn)
        per_T, wanted = max(1, round(1.0 / self.interval_T)), self.steering.decisions_per_T
        if wanted not in (None, per_T):
            raise ValueError(
                f"steering.decisions_per_T = {wanted}, but the control interval is "
                f"{self.interval_T:g} T: give {per_T}"
            )
        corners = torch.cartesian_prod(torch.tensor([0.0, 1.0]), torch.tensor([0.0, 1.0])).double()
        others = torch.zeros(4, self.num_draws - 2, dtype=torch.float64)
        self.check_starts(self.starts_from(torch.cat((corners, others), 1)))

    @cached_property
    def wake_patches(self) -> WakePatches:
        """Patches of disc and fish."""
        return place_patches(self, self.safe_area)

    def list_patches(self) -> tuple[Patch, ...]:
        """Return those of ``wake_patches``; in a free stream the fish has one."""
        return self.wake_patches.patches if self.discs else ()

    @property
    def num_flows(self) -> int:
        """Number of streams."""
        return len(self.stream.speeds_bl)

    @property
    def known_senses(self) -> Mapping[str, Sense]:
        """All senses of a fish in a stream."""
        return list_senses(self.lateral_line, stream_speed_bl=self.max_stream_speed_bl)

    @property
    def senses(self) -> tuple[Sense, ...]:
        """The senses that ``observes`` names."""
        shown = [name for name in self.observes if name != "flow_label" or self.reads_flow_class]
        return tuple(self.known_senses[name] for name in shown)

    @property
    def steers(self) -> bool:
        """Whether actions turn or bend the fish."""
        return bool(self.control.largest_turn or self.control.largest_bend)

    @property
    def mirrored_actions(self) -> tuple[int, ...]:
        """Mirror images given by ``control``; ValueError if ``steering`` has none."""
        if not (self.steers or self.steering.has_mirror):
            raise ValueError(
                f"reflect: {type(self.steering).__name__} does not turn as its mirror image would; "
                "take steering=pid-steering, or reflect=false"
            )
        return super().mirrored_actions

    @property
    def num_label_inputs(self) -> int:
        """One per flow if labels are observed, or none."""
        return self.num_flows if "flow_label" in self.observes else 0

    @property
    def num_samples(self) -> int:
        """Samples of the lateral line within an action."""
        return self.lateral_line.num_samples

    @property
    def inputs(self) -> tuple[str, ...]:
        """``flow_class``, if a transform writes it."""
        return ("flow_class",) if self.reads_flow_class else ()

    @property
    def flow_labels(self) -> list[dict[str, Any]]:
        """Parameters of each flow, in the order of ``flow_index``."""
        common = {
            "reynolds": self.reynolds,
            "body_length": self.body_length,
            "domain_bl": list(self.domain_bl),
        }
        return [{**label, **common} for label in self.stream.labels]

    def read_flow_labels(self) -> "KarmanGait":
        """Return the task whose macro actions use the row of the labelled flow."""
        return self if self.control.num_flows is None else replace(self, reads_flow_class=True)

    @property
    def lateral_line_layout(self) -> Mapping[str, Any]:
        """Description of the entry ``lateral_line`` for a classifier."""
        interval = self.interval_T / self.num_samples
        return self.lateral_line.layout | {"interval_T": interval}

    def starts_from(self, uniform: Tensor) -> TensorDict:
        """Draw nose position, flow, wake phase, key for sensor noise, and changes of the stream."""
        of = uniform.dtype, uniform.device
        ranges = make_constant((self.start_x_bl, self.start_y_bl), torch.float32, of[1]).to(uniform)
        low, high = ranges.T
        place = low + uniform[:, :2] * (high - low)
        flows = make_constant(self.start_flows, torch.int64, uniform.device)
        flow, key = flows[(uniform[:, 2] * len(flows)).long()], (uniform[:, 4] * 2.0**53).long()
        duration_T = self.time_limit * self.interval_T
        starts = {
            "head": make_constant(self.origin, *of) + self.body_length * place,
            "heading": torch.full_like(uniform[:, 0], pi),
            "flow_index": flow,
            "wake_phase": uniform[:, 3].clone(),
            "episode_key": key,
            **self.stream.draw_changes(flow, key, duration_T=duration_T),
        }
        return TensorDict(starts, uniform.shape[:1], device=uniform.device)

    def check_starts(self, starts: TensorDictBase) -> None:
        """Also check flow indices, and that no nose is in the danger area."""
        super().check_starts(starts)
        flow, num = starts["flow_index"], len(self.stream.speeds_bl)
        if not ((flow >= 0) & (flow < num)).all():
            raise ValueError(f"starts['flow_index'] = {flow.tolist()}: allowed is 0 to {num - 1}")
        self.safe_area.check_starts(self.locate(starts["head"]))

    def label_flow(self, before: TensorDictBase) -> Tensor:
        """Return the true flow, or the ``flow_class`` that a transform writes."""
        flow: Tensor = before["flow_class" if self.reads_flow_class else "flow_index"]
        # a GPU, for which the host would have to wait, takes the nearest
        if flow.device.type == "cpu" and not ((flow >= 0) & (flow < self.num_flows)).all():
            raise ValueError(f"flow_class = {flow.tolist()}: allowed is 0 to {self.num_flows - 1}")
        return flow

    def command(self, action: Tensor, before: TensorDictBase) -> Command:
        """Return the command of ``control``, turned by ``steering`` if actions do not steer."""
        command = super().command(action, before)
        if command.turn is None and command.bend is None:
            return command._replace(turn=self.steering.turn(before["steering"]))
        return command

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Measure position, heading, distance from the edges and the work done so far."""
        markers, body = solver.markers(), solver.body
        unit = (self.scales.reference_speed * self.body_length) ** 2
        now = {
            "place": self.locate(markers[:, 0]),
            "middle": self.locate(markers.mean(1)),
            "heading": body.heading.clone(),
            "age": body.age.clone(),
            "clearance": compute_clearance(markers, solver.config),
            "work": body.work / unit,
            "positive_work": body.positive_work / unit,
            "lateral_work": body.lateral_work / unit,
            "torque_work": body.torque_work / unit,
            **measure_own_motion(body, self.scales.period),
            **self.measure_stream(solver, starts["flow_index"]),
        }
        if (least_x := self.wake_patches.least_x) is not None:
            now["room"] = markers[..., 0].amin(1) - least_x
            now["clearance"] = torch.minimum(now["clearance"], now["room"] + self.wall_margin)
        return TensorDict(now, starts.batch_size, device=starts.device)

    def sense(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        """Return the signals of the lateral line, before any delay."""
        signals, velocity = self.lateral_line.sense(
            solver,
            starts["episode_key"],
            body_length=self.body_length,
            period=self.scales.period,
        )
        return {"sensed": signals, "sensed_velocity": velocity}

    def begin(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Start in the first gear of ``control``, at rest."""
        steering_input = self._observe_steering(now)
        return super().begin(now) | {
            "drift": torch.zeros_like(now["place"]),
            "steering": steering_input[:, None].expand(-1, self.steering.num_stacked, -1),
            "lateral_line": now["sensed"],
            "lateral_line_before": now["sensed"][:, -1],
            "velocity": now["sensed_velocity"],
        }

    def remember(
        self, before: TensorDictBase, action: Tensor, now: TensorDictBase
    ) -> dict[str, Tensor]:
        """Update displacement, steering inputs and delayed signals."""
        line = self.lateral_line
        return {
            "drift": now["place"] - before["place"],
            "steering": torch.cat(
                (before["steering"][:, 1:], self._observe_steering(now)[:, None]), 1
            ),
            "lateral_line": line.delay_series(before["sensed"], now["sensed"]),
            "lateral_line_before": before["lateral_line"][:, -1],
            "velocity": line.delay_series(before["sensed_velocity"], now["sensed_velocity"]),
        }

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        """Return r1 to r4 of the paper's Task 2, weighted by ``reward_terms``.

        A fish that bends pays for pushing work: net work near 0 needs muscles that store the work
        which the water does on them.

        Terms:
            hold: +1, or −1 if the downstream drift Δx > ``drift_limit_bl``.
            work: ``work_weight`` · (1 − W / ``work_reference``), with W the work of the muscles in
                the interval [ρ L² (L/T)²]; of a fish that bends, their pushing work.
            rim: −``rim_weight`` · d, with d the depth inside the rim of the safe area [L].
            danger: −``danger_penalty`` on entering the danger area or at an edge, 0 otherwise.
        """
        weights, area = self.reward_terms, self.safe_area
        paid = "positive_work" if self.control.largest_bend else "work"
        work = now[paid] - before[paid]
        depth = (area.rim_bl - area.measure_margin(now["place"])).clamp_min(0.0)
        return {
            "hold": torch.where(now["drift"][:, 0] > weights.drift_limit_bl, -1.0, 1.0),
            "work": weights.work_weight * (1.0 - work / weights.work_reference),
            "rim": -weights.rim_weight * depth,
            "danger": -weights.danger_penalty * self.is_terminated(now),
        }

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return whether the fish is in the danger area, at an edge or at the disc's patch."""
        hits_edge: Tensor = now["clearance"] < self.wall_margin
        return hits_edge | (self.safe_area.measure_margin(now["place"]) <= 0.0)

    @property
    def marker_speed(self) -> float:
        """Bound on the speed of a marker in nodes per step, turns and the stream included.

        It assumes that water in the wake is at most twice as fast as the stream.
        """
        turning = 0.0 if self.control.largest_bend else MAX_IMPOSED_SPEED
        stream = self.scales.stream_speed if self.stream.changes is None else MAX_WALL_SPEED
        return self.swimming_speed + turning + 2.0 * stream

    def count_safe_steps(self, now: TensorDictBase) -> Tensor:
        """Return how long the fish takes at least to an edge and to the danger area."""
        to_edge = now["clearance"] - self.wall_margin
        to_danger = self.safe_area.measure_margin(now["place"]) * self.body_length
        return torch.minimum(to_edge, to_danger) / self.marker_speed

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return lateral line, true flow and diagnostics."""
        names = ["flow_index", "gear", "frequency", "place", "drift", "facing", "yaw_rate"]
        names += ["heading", "work", "positive_work", "lateral_work", "torque_work", "lateral_line"]
        if self.stream.changes is not None:
            names.append("stream_speed")
        reported: dict[str, Tensor] = {name: now[name] for name in names}
        return reported | {"angle_of_attack": wrap_angle(now["heading"] - pi)}

    @property
    def title(self) -> str:
        """Name of the task."""
        return "Kármán gait"

    def name_endings(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Tell on which side the fish has left the safe area."""
        endings = self.safe_area.name_sides(now["place"])
        endings["hit an edge"] = now["clearance"] < self.wall_margin
        if self.wake_patches.least_x is not None:
            endings["turned back to the obstacle"] = now["room"] < 0.0
        return endings

    def add_to_scene(self, scene: Scene) -> Scene:
        """Add the safe area, the nose's place in it, the flow label and the lateral line."""
        area = self.safe_area
        x_bl = (area.near_bl, area.far_bl)
        place = (
            Series(key="place", column=0, label="x, downstream"),
            Series(key="place", column=1, label="y"),
        )
        neuromasts, signals = describe_lateral_line(
            self.lateral_line, body_length=self.body_length, speed=max(self.stream.speeds_bl)
        )
        speed = Panel(
            name="stream speed [L/T]", series=(Series(key="stream", column=0, label="speed"),)
        )
        feels = {"lateral_line", "water_velocity", "flow_label"} & set(self.observes)
        return scene.extend(
            areas=(self.frame("danger_area", x_bl=x_bl, aside_bl=area.aside_bl),),
            marks=(neuromasts,) if feels else (),
            panels=(
                *([speed] if self.stream.changes else []),
                describe_flow_label([label["name"] for label in self.flow_labels]),
                Panel(name="nose from the flat side [L]", series=place),
                *([signals] if feels else []),
            ),
            note="The danger area is outside the rectangle with red strokes.",
        )

    def read_scene(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        """Add the nose's place and the lateral line."""
        neuromasts = self.lateral_line.place(solver)[0]
        signal = self.sense(solver, starts)["sensed"][..., find_shown_feature(self.lateral_line)]
        return {
            "place": self.locate(solver.markers()[:, 0]),
            "neuromasts": neuromasts,
            "signal": signal.expand(neuromasts.shape[:2]),
        }

    def _observe_steering(self, now: TensorDictBase) -> Tensor:
        return self.steering.observe(now["place"], now["middle"], now["heading"])
