"""Hand-crafted controllers for predation: random actions, pursuit, interception.

They are baselines and read the same TensorDict as a learned policy: a stack of observations
``[x and y of the food from the head, distance, bearing error]``, oldest first, lengths in body
lengths (``_bl``), angles in radians, positive counter-clockwise; and write one of three actions:
0 turn clockwise, 1 keep the heading, 2 turn counter-clockwise; or the two numbers of a continuous
action: the turn, proportional to its largest one, and the highest tail-beat frequency. The control
interval is one tail beat (``_T``) of a fish at full speed.
"""

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

CLOCKWISE, KEEP, COUNTER_CLOCKWISE = 0, 1, 2
#: Numbers in one observation.
NUM_FEATURES = 4
#: Cruising speed of a fish, body lengths per tail beat, and radius of its tightest turn.
SWIM_SPEED_BL, TURN_RADIUS_BL = 0.4, 1.7
HORIZON_T = 40.0


def _act(tensordict: TensorDictBase, angle: Tensor, *, turn: float, is_continuous: bool) -> Tensor:
    """Return the action that turns by ``angle`` ``[B]``, at most ``turn``, at full speed.

    The first legal action stands in for an illegal one.
    """
    if is_continuous:
        share = (angle / turn).clamp(-1.0, 1.0)
        return torch.stack((share, torch.ones_like(share)), -1)
    action = torch.full_like(angle, KEEP, dtype=torch.int64)
    action[angle > 0.5 * turn] = COUNTER_CLOCKWISE
    action[angle < -0.5 * turn] = CLOCKWISE
    mask = tensordict["action_mask"]
    is_legal = mask.gather(-1, action.unsqueeze(-1)).squeeze(-1)
    return torch.where(is_legal, action, mask.int().argmax(-1))


class RandomPolicy(TensorDictModuleBase):
    """Draw uniformly among the legal actions, or each number of a continuous one in [-1, 1].

    Args:
        seed: seed of the policy's own generator.
        num_numbers: numbers in a continuous action; None for discrete actions.
    """

    def __init__(self, *, seed: int = 0, num_numbers: int | None = None) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation"], ["action"]
        if num_numbers is None:
            self.in_keys = ["action_mask"]
        self.seed, self.num_numbers = seed, num_numbers
        self._generator: torch.Generator | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]`` or ``[B, num_numbers]``."""
        given = tensordict[self.in_keys[0]]
        if self._generator is None:
            self._generator = torch.Generator(device=given.device).manual_seed(self.seed)
        if self.num_numbers is None:
            action = torch.multinomial(given.float(), 1, generator=self._generator).squeeze(-1)
        else:
            shape = (*tensordict.batch_size, self.num_numbers)
            drawn = torch.rand(shape, generator=self._generator, device=given.device)
            action = 2.0 * drawn - 1.0
        return tensordict.set("action", action)


class PursuitPolicy(TensorDictModuleBase):
    """Turn towards the food whenever the bearing error exceeds half the turn of one action.

    With continuous actions the turn equals the bearing error, up to the largest one.

    Args:
        turn: heading change of one action in radians; the largest one of a continuous action.
        is_continuous: whether actions are.
    """

    def __init__(self, *, turn: float = math.radians(15.0), is_continuous: bool = False) -> None:
        super().__init__()
        self.turn, self.is_continuous = turn, is_continuous
        self.in_keys, self.out_keys = ["observation_stack"], ["action"]
        if not is_continuous:
            self.in_keys.append("action_mask")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``."""
        bearing_error = tensordict["observation_stack"][..., -1]
        action = _act(tensordict, bearing_error, turn=self.turn, is_continuous=self.is_continuous)
        return tensordict.set("action", action)


class InterceptPolicy(TensorDictModuleBase):
    """Steer to the earliest point at which the fish can meet the food.

    Heading follows from each observation (direction of the food minus bearing error), the fish's
    velocity from the change of the x distance (the food moves along y only), and the food's
    velocity from the change of the y distance plus the fish's velocity. The controller steps
    through the coming ``HORIZON_T`` and picks the earliest meeting point that a turn of radius
    ``TURN_RADIUS_BL`` followed by a straight line reaches in time (Dubins 1957: shortest paths of
    bounded curvature, free final heading). Points inside the turning circle are out of reach, so a
    later one is chosen.

    With a known route, the controller predicts when the food starts and reverses. Otherwise it
    extrapolates the food's current velocity.

    Args:
        turn: heading change of one action in radians.
        food_speed_bl: speed of the moving food in body lengths per tail beat.
        food_limits_bl: lowest and highest y of the food, or ``None`` for an unknown route.
        food_start_bl: y of the food at rest; needed with ``food_limits_bl``.
        food_still_T: tail beats for which the food stays at rest after the start.
        food_direction: +1 if the food first moves up, -1 down, 0 to estimate it.
        is_continuous: see ``PursuitPolicy``.
    """

    def __init__(
        self,
        *,
        turn: float = math.radians(15.0),
        food_speed_bl: float = 0.3,
        food_limits_bl: tuple[float, float] | None = None,
        food_start_bl: float | None = None,
        food_still_T: float = 5.0,
        food_direction: int = 1,
        is_continuous: bool = False,
    ) -> None:
        super().__init__()
        self.is_continuous = is_continuous
        self.turn, self.food_speed_bl, self.food_still_T = turn, food_speed_bl, food_still_T
        self.food_limits_bl, self.food_start_bl = food_limits_bl, food_start_bl
        self.food_direction = food_direction
        self.in_keys = ["observation_stack"]
        if not is_continuous:
            self.in_keys.append("action_mask")
        if food_limits_bl is not None:
            self.in_keys.append("step_count")
        self.out_keys = ["action"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``."""
        stack = tensordict["observation_stack"].unflatten(-1, (-1, NUM_FEATURES))
        x, y, heading = stack[..., -1, :1], stack[..., -1, 1:2], _heading(stack[..., -1:, :])
        lead = torch.arange(0.0, HORIZON_T, 0.25, device=stack.device)
        velocity = self._food_velocity(stack).unsqueeze(-1)
        if self.food_limits_bl is None:
            rise = velocity * lead
        else:
            now = tensordict["step_count"].to(stack.dtype)
            direction = self._food_direction_of(velocity, now)
            rise = self._food_height(now + lead, direction) - self._food_height(now, direction)
        y, cos, sin = y + rise, heading.cos(), heading.sin()  # then, in the frame of the nose now
        length, angle = _shortest_path(cos * x + sin * y, cos * y - sin * x, TURN_RADIUS_BL)
        is_in_time = length <= SWIM_SPEED_BL * lead
        # Earliest meeting point; where there is none, the one missed by the least time.
        delay = torch.where(is_in_time, lead - HORIZON_T, length / SWIM_SPEED_BL - lead)
        angle = angle.gather(-1, delay.argmin(-1, keepdim=True)).squeeze(-1)
        action = _act(tensordict, angle, turn=self.turn, is_continuous=self.is_continuous)
        return tensordict.set("action", action)

    def _food_velocity(self, stack: Tensor) -> Tensor:
        """Estimate the food's velocity in y, ``[B]``: one of minus its speed, zero, its speed."""
        change = stack[..., 1:, :2] - stack[..., :-1, :2]
        is_new = change.abs().sum(-1) > 0  # after a reset the first observation fills the stack
        heading = _heading(stack)
        course = 0.5 * (heading[..., 1:] + heading[..., :-1])
        along = course.cos()
        # The food moves along y only: the change of x gives the fish's speed along its course.
        own = torch.where(
            along.abs() > 0.3, -change[..., 0] / along, torch.full_like(along, SWIM_SPEED_BL)
        )
        own = own.clamp(0.0, 2.0 * SWIM_SPEED_BL) * course.sin()
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
