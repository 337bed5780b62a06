"""Hand-crafted controllers for predation: random actions, pursuit, interception.

They are baselines and read the same TensorDict as a learned policy: a stack of observations
``[x and y of the food from the head, distance, bearing error]``, oldest first, lengths in body
lengths (``_bl``), angles in radians, positive counter-clockwise; and write one of three actions:
0 turn clockwise, 1 keep the heading, 2 turn counter-clockwise. The control interval is one tail
beat (``_T``).
"""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

CLOCKWISE, KEEP, COUNTER_CLOCKWISE = 0, 1, 2
#: Numbers in one observation.
NUM_FEATURES = 4


def _legal(action: Tensor, mask: Tensor) -> Tensor:
    """Replace an illegal action ``[B]`` by the first legal one of ``mask`` ``[B, A]``."""
    is_legal = mask.gather(-1, action.unsqueeze(-1)).squeeze(-1)
    return torch.where(is_legal, action, mask.int().argmax(-1))


def _turn_towards(angle: Tensor, half_turn: float) -> Tensor:
    """Choose the action that reduces the bearing error ``angle`` ``[B]``, positive to the left."""
    action = torch.full_like(angle, KEEP, dtype=torch.int64)
    action[angle > half_turn] = COUNTER_CLOCKWISE
    action[angle < -half_turn] = CLOCKWISE
    return action


class RandomPolicy(TensorDictModuleBase):
    """Draw uniformly among the legal actions.

    Args:
        seed: of the policy's own generator.
        mask_key: key of the mask ``[B, A]``, true where an action is legal.
    """

    def __init__(self, *, seed: int = 0, mask_key: str = "action_mask") -> None:
        super().__init__()
        self.in_keys, self.out_keys = [mask_key], ["action"]
        self.mask_key = mask_key
        self.seed = seed
        self._generator: torch.Generator | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]``."""
        mask = tensordict.get(self.mask_key)
        if self._generator is None:
            self._generator = torch.Generator(device=mask.device).manual_seed(self.seed)
        action = torch.multinomial(mask.float(), 1, generator=self._generator)
        return tensordict.set("action", action.squeeze(-1))


class PursuitPolicy(TensorDictModuleBase):
    """Turn towards the food whenever the bearing error exceeds half the turn of one action.

    Args:
        turn: heading change of one action in radians.
        in_key: key of the stacked observation ``[B, frames * 4]``.
        mask_key: key of the mask ``[B, 3]``.
    """

    def __init__(
        self,
        *,
        turn: float = math.radians(15.0),
        in_key: str = "observation_stack",
        mask_key: str = "action_mask",
    ) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [in_key, mask_key], ["action"]
        self.turn, self.in_key, self.mask_key = turn, in_key, mask_key

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]``."""
        bearing_error = tensordict.get(self.in_key)[..., -1]
        action = _turn_towards(bearing_error, 0.5 * self.turn)
        return tensordict.set("action", _legal(action, tensordict.get(self.mask_key)))


class InterceptPolicy(TensorDictModuleBase):
    """Steer to the earliest point at which the fish can meet the food.

    Heading follows from each observation (direction of the food minus bearing error), the fish's
    velocity from the change of the x distance (the food moves along y only), and the food's
    velocity from the change of the y distance plus that of the fish. The controller steps through
    the coming ``horizon_T`` and picks the earliest meeting point that a turn of radius
    ``turn_radius_bl`` followed by a straight line reaches in time (Dubins 1957: shortest paths of
    bounded curvature, free final heading). Points inside the turning circle are out of reach, so a
    later one is chosen.

    With a known route, the controller predicts when the food starts and reverses. Otherwise it
    extrapolates the food's current velocity.

    Args:
        turn: heading change of one action in radians.
        swim_speed_bl: cruising speed in body lengths per tail beat.
        turn_radius_bl: radius of the tightest turn in body lengths.
        food_speed_bl: speed of the moving food in body lengths per tail beat.
        food_limits_bl: lowest and highest y of the food, or ``None`` for an unknown route.
        food_start_bl: y of the food at rest; needed with ``food_limits_bl``.
        food_still_T: tail beats for which the food stays at rest after the start.
        food_direction: +1 if the food first moves up, -1 down, 0 to estimate it.
        horizon_T: how far to look ahead, in tail beats.
        in_key: key of the stacked observation ``[B, frames * 4]``.
        mask_key: key of the mask ``[B, 3]``.
        time_key: key of the number of decisions since the start ``[B, 1]``; read only with a known
            route.

    Raises:
        ValueError: if ``swim_speed_bl`` or ``turn_radius_bl`` is not positive, ``food_speed_bl`` is
            negative, or the route is incomplete.
    """

    def __init__(
        self,
        *,
        turn: float = math.radians(15.0),
        swim_speed_bl: float = 0.4,
        turn_radius_bl: float = 1.7,
        food_speed_bl: float = 0.3,
        food_limits_bl: tuple[float, float] | None = None,
        food_start_bl: float | None = None,
        food_still_T: float = 5.0,
        food_direction: int = 1,
        horizon_T: float = 40.0,
        in_key: str = "observation_stack",
        mask_key: str = "action_mask",
        time_key: str = "step_count",
    ) -> None:
        super().__init__()
        for name, value in (("swim_speed_bl", swim_speed_bl), ("turn_radius_bl", turn_radius_bl)):
            if value <= 0:
                raise ValueError(f"{name} = {value}: must be greater than 0")
        if food_speed_bl < 0:
            raise ValueError(f"food_speed_bl = {food_speed_bl}: must not be negative")
        if food_limits_bl is not None and (
            food_start_bl is None or not food_limits_bl[0] <= food_start_bl <= food_limits_bl[1]
        ):
            raise ValueError(
                f"food_start_bl = {food_start_bl}: must lie inside food_limits_bl = "
                f"{food_limits_bl} when these are given"
            )
        self.turn, self.swim_speed_bl, self.turn_radius_bl = turn, swim_speed_bl, turn_radius_bl
        self.food_speed_bl, self.food_still_T = food_speed_bl, food_still_T
        self.food_limits_bl, self.food_start_bl = food_limits_bl, food_start_bl
        self.food_direction, self.horizon_T = food_direction, horizon_T
        self.in_key, self.mask_key, self.time_key = in_key, mask_key, time_key
        self.in_keys = [in_key, mask_key]
        if food_limits_bl is not None:
            self.in_keys.append(time_key)
        self.out_keys = ["action"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]``."""
        stack = tensordict.get(self.in_key).unflatten(-1, (-1, NUM_FEATURES))
        food = stack[..., -1, :2]
        heading = _heading(stack[..., -1, :])
        lead = torch.arange(0.0, self.horizon_T, 0.25, device=stack.device)
        velocity = self._food_velocity(stack).unsqueeze(-1)
        if self.food_limits_bl is None:
            rise = velocity * lead
        else:
            now = tensordict.get(self.time_key).to(stack.dtype)
            direction = self._food_direction_of(velocity, now)
            rise = self._food_height(now + lead, direction) - self._food_height(now, direction)
        ahead_of, left_of = _body_frame(food.unsqueeze(-2), rise, heading.unsqueeze(-1))
        length, angle = _shortest_path(ahead_of, left_of, self.turn_radius_bl)
        is_in_time = length <= self.swim_speed_bl * lead
        # Earliest meeting point; where there is none, the one missed by the least time.
        delay = torch.where(is_in_time, lead - self.horizon_T, length / self.swim_speed_bl - lead)
        angle = angle.gather(-1, delay.argmin(-1, keepdim=True)).squeeze(-1)
        action = _turn_towards(angle, 0.5 * self.turn)
        return tensordict.set("action", _legal(action, tensordict.get(self.mask_key)))

    def _food_velocity(self, stack: Tensor) -> Tensor:
        """Estimate the food's velocity in y, ``[B]``: one of minus its speed, zero, its speed."""
        change = stack[..., 1:, :2] - stack[..., :-1, :2]
        is_new = change.abs().sum(-1) > 0  # after a reset the first observation fills the stack
        heading = _heading(stack)
        course = 0.5 * (heading[..., 1:] + heading[..., :-1])
        along = course.cos()
        # The food moves along y only: the change of x gives the fish's speed along its course.
        own = torch.where(
            along.abs() > 0.3, -change[..., 0] / along, torch.full_like(along, self.swim_speed_bl)
        )
        own = own.clamp(0.0, 2.0 * self.swim_speed_bl) * course.sin()
        velocity = change[..., 1] + own
        last = velocity[..., -1]  # the current one, even if the food has just reversed
        moving = last.sign() * self.food_speed_bl
        is_moving = (last.abs() > 0.5 * self.food_speed_bl) & is_new[..., -1]
        return torch.where(is_moving, moving, torch.zeros_like(moving))

    def _food_direction_of(self, velocity: Tensor, now: Tensor) -> Tensor:
        """Return the food's first direction ``[B, 1]``, known or estimated from ``velocity``."""
        up = torch.ones_like(velocity)
        if self.food_direction != 0:
            return up * self.food_direction
        before = (now - 1.0).clamp_min(0.0)
        misfit = [
            (self._food_height(now, way) - self._food_height(before, way) - velocity).abs()
            for way in (up, -up)
        ]
        return torch.where(misfit[0] <= misfit[1], up, -up)

    def _food_height(self, time: Tensor, direction: Tensor) -> Tensor:
        """Return y of the food at ``time`` (in T): at rest, then oscillating between its limits."""
        low, high = self.food_limits_bl or (0.0, 0.0)
        travelled = self.food_speed_bl * (time - self.food_still_T).clamp_min(0.0)
        span = max(high - low, 1e-9)
        offset = (self.food_start_bl or low) - low
        start = torch.where(direction > 0, offset, 2.0 * span - offset)
        folded = (start + travelled) % (2.0 * span)
        return low + torch.minimum(folded, 2.0 * span - folded)


def _heading(observation: Tensor) -> Tensor:
    """Return the heading of the fish ``[...]`` in radians from observations ``[..., 4]``."""
    return torch.atan2(observation[..., 1], observation[..., 0]) - observation[..., 3]


def _body_frame(food: Tensor, rise: Tensor, heading: Tensor) -> tuple[Tensor, Tensor]:
    """Return future positions of the food in the frame of the nose: ahead and left, ``[B, K]``.

    ``food`` ``[B, 1, 2]`` is its current position, ``rise`` ``[B, K]`` its displacement in y by
    then, and ``heading`` ``[B, 1]`` the current heading of the fish.
    """
    x, y = food[..., 0], food[..., 1] + rise
    cos, sin = heading.cos(), heading.sin()
    return cos * x + sin * y, cos * y - sin * x


def _shortest_path(ahead: Tensor, left: Tensor, radius: float) -> tuple[Tensor, Tensor]:
    """Return length and initial turning angle (positive: left) of the shortest path to a point.

    A path is a turn of ``radius`` to either side followed by a straight line. Points inside the
    turning circle of a side have infinite length on that side.
    """
    lengths, angles = [], []
    for side in (1.0, -1.0):
        sideways = side * left - radius
        centre_distance = torch.hypot(ahead, sideways)
        is_outside = centre_distance >= radius
        distance = centre_distance.clamp_min(radius)
        tangent = torch.atan2(sideways, ahead) - torch.acos(radius / distance) + 0.5 * math.pi
        arc = tangent % (2.0 * math.pi)
        arc = torch.where(arc > 2.0 * math.pi - 1e-3, torch.zeros_like(arc), arc)  # round-off
        straight = (distance.square() - radius**2).clamp_min(0.0).sqrt()
        lengths.append(torch.where(is_outside, radius * arc + straight, torch.inf))
        angles.append(side * arc)
    is_left = lengths[0] <= lengths[1]
    length = torch.where(is_left, lengths[0], lengths[1])
    return length, torch.where(is_left, angles[0], angles[1])
