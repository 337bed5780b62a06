"""Hand-crafted controllers for predation: random actions, pursuit, interception.

They are baselines and read the same TensorDict as a learned policy: a stack of observations
``[x and y of the food from the head, distance, bearing error]``, oldest first, lengths in body
lengths (``_bl``), angles in radians, positive counter-clockwise; and write one of three actions:
0 turn clockwise, 1 keep the heading, 2 turn counter-clockwise; or the two numbers of a continuous
action: the turn, proportional to its largest one, and the highest tail-beat frequency. The control
interval is one tail beat (``_T``) of a fish at full speed.
"""

import math
from abc import abstractmethod

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


class _TurningPolicy(TensorDictModuleBase):
    """Base of controllers that turn towards the food at full speed.

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

    @abstractmethod
    def aim(self, tensordict: TensorDictBase) -> Tensor:
        """Return the angle ``[B]`` to turn by, radians."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``: the turn, at most ``turn``, at full speed.

        The first legal action stands in for an illegal one.
        """
        angle = self.aim(tensordict)
        if self.is_continuous:
            share = (angle / self.turn).clamp(-1.0, 1.0)
            return tensordict.set("action", torch.stack((share, torch.ones_like(share)), -1))
        action = torch.full_like(angle, KEEP, dtype=torch.int64)
        action[angle > 0.5 * self.turn] = COUNTER_CLOCKWISE
        action[angle < -0.5 * self.turn] = CLOCKWISE
        mask = tensordict["action_mask"]
        is_legal = mask.gather(-1, action.unsqueeze(-1)).squeeze(-1)
        return tensordict.set("action", torch.where(is_legal, action, mask.int().argmax(-1)))


class PursuitPolicy(_TurningPolicy):
    """Turn towards the food whenever the bearing error exceeds half the turn of one action.

    With continuous actions the turn equals the bearing error, up to the largest one.

    Args:
        turn: heading change of one action in radians; the largest one of a continuous action.
        is_continuous: whether actions are.
    """

    def aim(self, tensordict: TensorDictBase) -> Tensor:
        """Return the bearing error."""
        bearing_error: Tensor = tensordict["observation_stack"][..., -1]
        return bearing_error


class InterceptPolicy(_TurningPolicy):
    """Steer to the earliest point at which the fish can meet the food, whose route is known.

    Heading follows from each observation (direction of the food minus bearing error). The
    controller steps through the coming ``HORIZON_T``, in which it knows when the food starts and
    reverses, and picks the earliest meeting point that a turn of radius ``TURN_RADIUS_BL`` followed
    by a straight line reaches in time (Dubins 1957: shortest paths of bounded curvature, free final
    heading). Points inside the turning circle are out of reach, so a later one is chosen.

    Args:
        food_speed_bl: speed of the moving food in body lengths per tail beat.
        food_limits_bl: lowest and highest y of the food.
        food_start_bl: y of the food at rest.
        food_still_T: tail beats for which the food stays at rest after the start.
        food_direction: +1 if the food first moves up, -1 down.
        turn: see ``PursuitPolicy``.
        is_continuous: see ``PursuitPolicy``.
    """

    def __init__(
        self,
        *,
        food_speed_bl: float,
        food_limits_bl: tuple[float, float],
        food_start_bl: float,
        food_still_T: float,
        food_direction: int,
        turn: float = math.radians(15.0),
        is_continuous: bool = False,
    ) -> None:
        super().__init__(turn=turn, is_continuous=is_continuous)
        self.in_keys.append("step_count")
        self.food_speed_bl, self.food_still_T = food_speed_bl, food_still_T
        self.food_limits_bl, self.food_start_bl = food_limits_bl, food_start_bl
        self.food_direction = food_direction

    def aim(self, tensordict: TensorDictBase) -> Tensor:
        """Return the turn of the shortest path to the meeting point."""
        stack = tensordict["observation_stack"].unflatten(-1, (-1, NUM_FEATURES))
        x, y = stack[..., -1, :1], stack[..., -1, 1:2]
        heading = torch.atan2(y, x) - stack[..., -1, 3:]
        lead = torch.arange(0.0, HORIZON_T, 0.25, device=stack.device)
        now = tensordict["step_count"].to(stack.dtype)
        rise = self._food_height(now + lead) - self._food_height(now)
        y, cos, sin = y + rise, heading.cos(), heading.sin()  # then, in the frame of the nose now
        length, angle = _shortest_path(cos * x + sin * y, cos * y - sin * x, TURN_RADIUS_BL)
        is_in_time = length <= SWIM_SPEED_BL * lead
        # Earliest meeting point; where there is none, the one missed by the least time.
        delay = torch.where(is_in_time, lead - HORIZON_T, length / SWIM_SPEED_BL - lead)
        return angle.gather(-1, delay.argmin(-1, keepdim=True)).squeeze(-1)

    def _food_height(self, time: Tensor) -> Tensor:
        """Return y of the food at ``time`` (in T): at rest, then oscillating between its limits."""
        low, high = self.food_limits_bl
        travelled = self.food_speed_bl * (time - self.food_still_T).clamp_min(0.0)
        span, offset = high - low, self.food_start_bl - low
        start = offset if self.food_direction > 0 else 2.0 * span - offset
        folded = (start + travelled) % (2.0 * span)
        return low + torch.minimum(folded, 2.0 * span - folded)


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
