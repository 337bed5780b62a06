"""Predation, the paper's first task: catch moving food without touching a wall."""

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from math import ceil, floor, pi
from typing import ClassVar

import torch
from pydantic import NonNegativeFloat, PositiveFloat
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs.agents import shape_fish
from fishrl.envs.constants import make_constant
from fishrl.envs.control import AbstractControlTask, Control, Turn
from fishrl.envs.extensions import HasScene
from fishrl.envs.scene import Marks, Panel, Scene, Series
from fishrl.envs.sense import Sense
from fishrl.envs.senses import OWN_SENSES, measure_own_motion
from fishrl.envs.sensors import MIRRORED_TARGET, TARGET, compute_clearance, sense_target
from fishrl.envs.task import AbstractTask
from fishrl.envs.tasks.food import AbstractFoodTask
from fishrl.physics.fast.solver import InPlaceSolver


class AbstractPredation(AbstractControlTask, AbstractFoodTask, HasScene):
    """Base of tasks in which fish catch food, whose path ``AbstractFoodTask`` describes.

    By default actions turn the fish: 0 right (clockwise), 1 straight, 2 left. A fish with
    ``control=Bend()`` also observes its own motion, see ``senses.OWN_SENSES``; it should decide
    several times per T.

    Args:
        control: commands of the actions.
        start_x_bl: range of the initial nose position, in body lengths. Fish start on whole nodes
            and face -x; the range is clipped to keep them clear of the walls.
        start_y_bl: the same along y.
        capture_radius_bl: distance from nose to food that counts as capture.
        capture_reward: reward of a capture, in the paper 20. Approaching for ever is worth up to
            1 / (1 - gamma), 100 at gamma = 0.99: below that, a fish earns more by never arriving.
    """

    success: ClassVar[str] = "captured"
    former: ClassVar[Mapping[str, str]] = {
        **AbstractTask.former,
        "action": "give control.beat=continuous-frequency",
        "bends": "give control=bend",
        "turn_degrees": "give control.turn_degrees",
        "frequency_range": "give control.beat.frequency_range",
    }

    control: Control = Turn()
    start_x_bl: tuple[float, float] = (5.0, 7.5)
    start_y_bl: tuple[float, float] = (0.25, 4.75)
    capture_radius_bl: PositiveFloat = 0.25
    capture_reward: NonNegativeFloat = 20.0

    def __post_init__(self) -> None:
        super().__post_init__()
        (x_low, x_high), (y_low, y_high) = self.start_range
        if x_low > x_high or y_low > y_high:
            raise ValueError(
                f"start_x_bl = {self.start_x_bl}, start_y_bl = {self.start_y_bl}: a fish that "
                f"faces -x and keeps {self.wall_margin:g} nodes from the walls does not fit; widen "
                "the ranges, or enlarge domain_bl"
            )
        x, y = self.food_x_bl * self.body_length, self.food_y_bl * self.body_length
        gap_x, gap_y = max(x_low - x, x - x_high, 0.0), max(y_low - y, y - y_high, 0.0)
        if gap_x**2 + gap_y**2 <= (self.capture_radius_bl * self.body_length) ** 2:
            raise ValueError(
                f"start_x_bl = {self.start_x_bl}, start_y_bl = {self.start_y_bl}: a fish may start "
                "with its food in reach; move the food or the starts by more than "
                f"capture_radius_bl = {self.capture_radius_bl}"
            )

    @property
    def bends(self) -> bool:
        """Whether actions bend the fish."""
        return self.control.largest_bend > 0.0

    @property
    def max_frequency(self) -> float:
        """Highest tail-beat frequency, beats per T; at least 1, with which each episode begins."""
        return max(1.0, super().max_frequency)

    @cached_property
    def start_range(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """First and last node of the initial nose position, along x and along y.

        The requested ranges are clipped so that the fish keeps ``wall_margin_bl`` from the edges:
        along x by its length, along y by the largest sum of half-thickness and amplitude.
        """
        length, config = self.body_length, self.flow_config()
        x, h = self.fish.draw()[0].T
        amplitude = length * self.fish.gait.evaluate_envelope(x / length)
        half_width = self.wall_margin + float((h + amplitude).max())
        x = (
            ceil(max(self.start_x_bl[0] * length, self.wall_margin)),
            floor(min(self.start_x_bl[1] * length, config.width - 1 - self.wall_margin - length)),
        )
        y = (
            ceil(max(self.start_y_bl[0] * length, half_width)),
            floor(min(self.start_y_bl[1] * length, config.height - 1 - half_width)),
        )
        return x, y

    def check_starts(self, starts: TensorDictBase) -> None:
        """Also check that no food is in reach and that its direction is 1 or -1."""
        super().check_starts(starts)
        food = self.locate_food(starts, torch.zeros_like(starts["food_direction"]))
        away = starts["head"].view(-1, self.num_fish, 2) - food[:, None]
        if ((away * away).sum(-1).sqrt() <= self.capture_radius).any():
            raise ValueError(
                f"starts has a fish within capture_radius = {self.capture_radius:g} nodes of its "
                "food: move it away"
            )
        if (starts["food_direction"].abs() != 1.0).any():
            raise ValueError("starts['food_direction'] must be 1 (up) or -1 (down) everywhere")

    @property
    def capture_radius(self) -> float:
        """Distance from nose to food that counts as capture, in nodes."""
        return self.capture_radius_bl * self.body_length

    @property
    def marker_speed(self) -> float:
        """Bound on the speed of a marker in nodes per step, commanded turns included."""
        # a turn takes the whole interval and is twice as fast at its middle as on average
        turning = 2.0 * self.control.largest_turn / self.n_substeps * self.body_length
        return self.swimming_speed + turning

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        """Return approach and capture, ``[B]``, or ``[B, M]`` of M fish.

        If actions are continuous, or bends, approach counts for each beat: if each decision counted
        alike, the slowest approach would be rewarded most.

        Terms:
            approach: +1 if the distance d or the bearing error ``|β|`` of the food has shrunk (the
                paper: "bearing or distance shrinks"), −1 otherwise; times the number of tail beats
                if actions are continuous, or bends.
            capture: ``capture_reward`` if d ≤ ``capture_radius_bl``, 0 otherwise.
        """
        (old_distance, old_error), (distance, error) = (
            td["target"][..., 2:].unbind(-1)  # distance and bearing error
            for td in (before, now)
        )
        comes_nearer = (distance < old_distance) | (error.abs() < old_error.abs())
        approach = torch.where(comes_nearer, 1.0, -1.0)
        if self.action_bounds is not None or self.bends:
            approach = approach * (now["beats"] - before["beats"])
        return {"approach": approach, "capture": self.capture_reward * self.has_caught(now)}

    def has_caught(self, now: TensorDictBase) -> Tensor:
        """Return whether the food is within reach, ``[B]``, or ``[B, M]`` of M fish."""
        distance: Tensor = now["target"][..., 2]
        return distance <= self.capture_radius_bl

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        """Return whether the food is captured or a wall is hit, by any fish."""
        hits_wall: Tensor = now["clearance"] < self.wall_margin
        return _list_fish(hits_wall | self.has_caught(now)).any(1)

    def count_safe_steps(self, now: TensorDictBase) -> Tensor:
        """Return how long the nearest fish takes at least to a wall and to the food."""
        speed = self.marker_speed
        food_speed = self.food_ranges["food_speed"][1] * self.body_length / self.scales.period
        distance = now["target"][..., 2] * self.body_length - self.capture_radius
        to_food = distance / (speed + food_speed)
        to_wall = (now["clearance"] - self.wall_margin) / speed
        return _list_fish(torch.minimum(to_wall, to_food)).amin(1)

    @property
    def lanes(self) -> tuple[tuple[int, int], ...]:
        """First and last node of the nose of each fish along y."""
        return (self.start_range[1],)

    def starts_from(self, uniform: Tensor) -> TensorDict:
        """Draw nose positions (on nodes, facing -x) and the path of the food."""
        (left, right), shape = self.start_range[0], shape_fish(self, len(uniform))
        ends = zip(*(((left, low), (right, high)) for low, high in self.lanes), strict=True)
        low, high = (make_constant(end, uniform.dtype, uniform.device) for end in ends)
        places, chance = uniform.split((2 * self.num_fish, self.num_draws - 2 * self.num_fish), 1)
        head = low + torch.floor(places.view(-1, self.num_fish, 2) * (high - low + 1.0))
        heading = torch.full(shape, pi, dtype=torch.float64, device=uniform.device)
        starts = {"head": head.view(*shape, 2), "heading": heading} | self.draw_path(chance)
        return TensorDict(starts, shape[:1], device=uniform.device)

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Measure heading, own motion, food and distance from the walls of each fish."""
        return self._measure_fishes(solver, starts, self.locate_food(starts, solver.body.age))

    def _measure_fishes(
        self, solver: InPlaceSolver, starts: TensorDictBase, food: Tensor
    ) -> TensorDict:
        shape = shape_fish(self, len(starts))
        each = [self._measure_fish(solver, index, food) for index in range(self.num_fish)]
        now = {name: torch.stack([own[name] for own in each], 1) for name in each[0]}
        now = {name: value.view(*shape, *value.shape[2:]) for name, value in now.items()}
        return TensorDict(now, starts.batch_size, device=starts.device)

    @abstractmethod
    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return ``captured`` ``[B]``, whether the episode succeeds, at least."""

    def _measure_fish(self, solver: InPlaceSolver, index: int, food: Tensor) -> dict[str, Tensor]:
        body, markers = solver.bodies[index], solver.markers(index)
        heading, motion = body.heading, body.position[:, :0]
        if self.bends:
            heading = heading + body.internal_angle
            motion = measure_own_motion(body, self.scales.period)["own_motion"]
        return {
            "heading": heading,
            "beats": body.beats,
            "own_motion": motion,
            "target": sense_target(markers[:, 0], heading, food, body_length=self.body_length),
            "clearance": compute_clearance(markers, solver.config),
        }

    def read_scene(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        """Add the food and its distance from the nearest nose."""
        food = self.locate_food(starts, solver.body.age)
        noses = torch.stack([solver.markers(index)[:, 0] for index in range(self.num_fish)], 1)
        distance = (food[:, None] - noses).norm(dim=-1).amin(1) / self.body_length
        return {"food": food, "distance": distance}

    @property
    def mirrored_actions(self) -> tuple[int, ...]:
        """Mirror images given by ``control``; ValueError unless the food's paths are symmetric."""
        if not self.is_mirrored:
            raise ValueError(
                f"reflect: food_direction = {self.food_direction}, food_y_bl = {self.food_y_bl}, "
                f"food_limits_bl = {self.food_limits_bl}, food_tilt_degrees = "
                f"{self.food_tilt_degrees}: the mirrored food takes other paths; take random, and "
                f"paths symmetric about y = {0.5 * self.domain_bl[1]:g} L, or reflect=false"
            )
        return super().mirrored_actions

    @property
    def senses(self) -> tuple[Sense, ...]:
        """The motion of a fish that bends, and the food as seen from the nose."""
        food = Sense("place of the food", TARGET, lambda now: now["target"], MIRRORED_TARGET)
        return (*[OWN_SENSES["own_motion"]] * self.bends, food)

    def name_endings(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Tell whether the food was caught or a wall was hit, by any fish."""
        flags = {"caught": self.has_caught(now), "hit a wall": now["clearance"] < self.wall_margin}
        return {words: _list_fish(flag).any(1) for words, flag in flags.items()}

    def add_to_scene(self, scene: Scene) -> Scene:
        """Add the food and its distance."""
        food = Marks(
            key="food",
            name="food",
            radius=3.0 * self.body_length / 50.0,
            colour=(242, 177, 52),
            reach=self.capture_radius,
        )
        series = (Series(key="distance", label="nose to food"),)
        return scene.extend(
            marks=(food,),
            panels=(Panel(name="distance of the food [L]", series=series),),
            note="The circle around the food is the capture radius.",
        )


class Predation(AbstractPredation):
    """Catch food that rests at first and then moves up and down between two limits.

    An episode terminates on capture or when a marker comes within ``wall_margin_bl`` of the edge.

    The paper (Task 1) gives neither the food's x and limits nor the capture radius.
    """

    body_length: int = 64
    levels: int = 2

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        """Also foresee the food."""
        places = self.foresee_food(starts, solver.body.age)
        now = self._measure_fishes(solver, starts, places[:, 0])
        return now.set("food_ahead", (places / self.body_length).float())

    def report(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return ``captured`` ``[B]``, and ``food_ahead``, the path of the food."""
        return {"captured": self.has_caught(now), "food_ahead": now["food_ahead"]}


def _list_fish(values: Tensor) -> Tensor:
    """Return values ``[B]`` of one fish, or ``[B, M]`` of several, as ``[B, M]``."""
    return values.view(len(values), -1)
