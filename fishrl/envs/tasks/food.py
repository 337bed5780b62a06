"""Food that rests at first and then moves to and fro, on a path that each episode may draw."""

from functools import cached_property
from math import isclose, radians, sin
from typing import Annotated, Literal

import torch
from pydantic import AfterValidator, Field, NonNegativeFloat
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.task import AbstractTask

#: Probability that the food first moves up.
CHANCE_UP = {"up": 1.0, "down": 0.0, "random": 0.5}
#: ``food_ahead`` has so many places of the food, from now on at intervals of so many T.
NUM_AHEAD, LEAD_T = 160, 0.25
_Speed = Annotated[float, Field(ge=0, le=100)]
_Angle = Annotated[float, Field(ge=-90, le=90)]


def _find_ends(value: float | tuple[float, float]) -> tuple[float, float]:
    """Return the ends of a range; both ends of a number are the number."""
    return value if isinstance(value, tuple) else (value, value)


def _check_range(value: float | tuple[float, float]) -> float | tuple[float, float]:
    low, high = _find_ends(value)
    if low > high:
        raise ValueError("a number, or a range from low to high")
    return value


_IsRange = AfterValidator(_check_range)


class AbstractFoodTask(AbstractTask):
    """Base of tasks with food that moves to and fro on a straight line through its place of rest.

    Where its path has a range instead of a number, each episode draws its own value, uniformly.

    Args:
        food_x_bl: x of the food, in body lengths from the left edge.
        food_y_bl: initial y of the food.
        food_limits_bl: lowest and highest y of the food on an upright line, each a number or a
            range.
        food_tilt_degrees: angle of the line from upright, positive counter-clockwise; or a range.
        food_still_T: periods for which the food rests; or a range.
        food_speed_bl: speed of the food afterwards, body lengths per period; or a range.
        food_direction: initial direction of the food: up, down or random.
    """

    food_x_bl: float = 2.5
    food_y_bl: float = 2.5
    food_limits_bl: tuple[
        Annotated[float | tuple[float, float], _IsRange],
        Annotated[float | tuple[float, float], _IsRange],
    ] = (1.5, 3.5)
    food_tilt_degrees: Annotated[_Angle | tuple[_Angle, _Angle], _IsRange] = 0.0
    food_still_T: Annotated[
        NonNegativeFloat | tuple[NonNegativeFloat, NonNegativeFloat], _IsRange
    ] = 5.0
    food_speed_bl: Annotated[_Speed | tuple[_Speed, _Speed], _IsRange] = 0.3
    food_direction: Literal["up", "down", "random"] = "up"

    def __post_init__(self) -> None:
        super().__post_init__()
        (low, low_to), (high_from, high) = map(_find_ends, self.food_limits_bl)
        width, height = self.domain_bl
        if not 0.0 < low <= low_to <= self.food_y_bl <= high_from <= high < height or low == high:
            raise ValueError(
                f"food_y_bl = {self.food_y_bl}, food_limits_bl = {self.food_limits_bl}: allowed is "
                f"0 < lower limit <= food_y_bl <= upper limit < {height}, the limits not equal"
            )
        if not 0.0 < self.food_x_bl < width:
            raise ValueError(f"food_x_bl = {self.food_x_bl}: must lie inside (0, {width})")
        tilt = radians(max(map(abs, _find_ends(self.food_tilt_degrees))))
        reach = max(high - self.food_y_bl, self.food_y_bl - low) * sin(tilt)
        if not reach < min(self.food_x_bl, width - self.food_x_bl):
            raise ValueError(
                f"food_tilt_degrees = {self.food_tilt_degrees}: the food would reach {reach:.3g} L "
                "to the side, and leave the tank; tilt it less, or change food_x_bl"
            )

    @cached_property
    def food_ranges(self) -> dict[str, tuple[float, float]]:
        """Ends of the range of each number of the food's path; starts have those that differ."""
        low, high = self.food_limits_bl
        path = {
            "food_low": low,
            "food_high": high,
            "food_tilt": self.food_tilt_degrees,
            "food_still": self.food_still_T,
            "food_speed": self.food_speed_bl,
        }
        return {name: _find_ends(value) for name, value in path.items()}

    @property
    def is_mirrored(self) -> bool:
        """Whether the mirror image of each path of the food is as probable as the path."""
        (low, low_to), (high_from, high) = map(_find_ends, self.food_limits_bl)
        least_tilt, largest_tilt = _find_ends(self.food_tilt_degrees)
        height = self.domain_bl[1]
        return (
            self.food_direction == "random"
            and isclose(self.food_y_bl, 0.5 * height)
            and isclose(low + high, height)
            and isclose(low_to + high_from, height)
            and isclose(least_tilt, -largest_tilt)
        )

    @property
    def num_draws(self) -> int:
        """Numbers drawn for a start: places of noses, the food's direction, and one per range."""
        num_ranges = sum(low < high for low, high in self.food_ranges.values())
        return 2 * self.num_fish + 1 + num_ranges

    def locate_food(self, starts: TensorDictBase, age: Tensor) -> Tensor:
        """Return the food's position ``[B, 2]``, nodes, at ``age`` ``[B]`` steps since reset.

        Ages ``[B, K]`` give ``[B, K, 2]``.
        """
        shape = (-1, *(1,) * (age.dim() - 1))
        direction = starts["food_direction"].view(shape)
        low, high, tilt, still, speed = (
            starts[name].view(shape) if name in starts else least
            for name, (least, _) in self.food_ranges.items()
        )
        span, offset = high - low, self.food_y_bl - low
        swum = speed * (age / self.scales.period - still).clamp(min=0.0)
        # A periodic path of length 2 span, folded at its middle.
        along = torch.where(direction > 0.0, offset + swum, 2.0 * span - offset + swum)
        along = torch.remainder(along, 2.0 * span)
        height = low + torch.minimum(along, 2.0 * span - along)
        rise, tilt = height - self.food_y_bl, torch.as_tensor(tilt, dtype=torch.float64).deg2rad()
        x, y = self.food_x_bl - tilt.sin() * rise, height - (1.0 - tilt.cos()) * rise
        return self.body_length * torch.stack((x, y), -1)

    def foresee_food(self, starts: TensorDictBase, age: Tensor) -> Tensor:
        """Return the food's ``NUM_AHEAD`` places ``[B, K, 2]``, nodes, ahead every ``LEAD_T``."""
        leads = torch.arange(NUM_AHEAD, device=age.device) * (LEAD_T * self.scales.period)
        return self.locate_food(starts, age[:, None] + leads)

    def draw_path(self, chance: Tensor) -> dict[str, Tensor]:
        """Draw the food's direction and the numbers of its path that have a range.

        Args:
            chance: random numbers ``[E, 1 + number of ranges]`` in [0, 1), float64.
        """
        up, *others = chance.unbind(1)
        drawn = {"food_direction": torch.where(up < CHANCE_UP[self.food_direction], 1.0, -1.0)}
        for name, (low, high) in self.food_ranges.items():
            if low < high:
                drawn[name] = low + (high - low) * others.pop(0)
        return {name: value.to(chance) for name, value in drawn.items()}
