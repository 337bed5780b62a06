"""Hand-crafted controllers for predation: random actions, pursuit, interception.

They are baselines and read the same TensorDict as a learned policy: a stack of observations
``[x and y of the food from the head, distance, bearing error]``, oldest first, lengths in body
lengths (``_bl``), angles in radians, positive counter-clockwise; and write one of three actions:
0 turn clockwise, 1 keep the heading, 2 turn counter-clockwise, or 3 b + this with the last legal
action b of the tail beat; or the numbers of a continuous action: the turn, proportional to its
largest one, and the highest tail-beat frequency and amplitude. The control interval is one tail
beat (``_T``) of a fish at full speed.
"""

import math
from abc import abstractmethod

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn.functional import pad

CLOCKWISE, KEEP, COUNTER_CLOCKWISE = 0, 1, 2
#: Numbers in one observation.
NUM_FEATURES = 4
#: Time between the places of the food that a task foresees, as in ``envs.tasks.food``.
LEAD_T = 0.25


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
        turn: heading change of one action in radians; the largest one of a continuous action. Of a
            fish that bends, the angle to turn by for which it bends most.
        num_numbers: numbers in a continuous action; None for discrete actions.
        yaw_damping_T: angle to turn by less for each radian per T at which the fish turns. Unless
            0, the yaw rate is observed just before the food, the last of the fish's own motion.
    """

    def __init__(
        self,
        *,
        turn: float = math.radians(15.0),
        num_numbers: int | None = None,
        yaw_damping_T: float = 0.0,
    ) -> None:
        super().__init__()
        self.turn, self.num_numbers, self.yaw_damping_T = turn, num_numbers, yaw_damping_T
        self.in_keys, self.out_keys = ["observation_stack"], ["action"]
        if num_numbers is None:
            self.in_keys.append("action_mask")

    @abstractmethod
    def aim(self, tensordict: TensorDictBase) -> Tensor:
        """Return the angle ``[B]`` to turn by, radians."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``: the turn, at most ``turn``, at full speed.

        Where no action to this side is legal, the last legal one stands in.
        """
        angle = self.aim(tensordict)
        if self.yaw_damping_T:
            yaw_rate = tensordict["observation_stack"][..., -NUM_FEATURES - 1]
            angle = angle - self.yaw_damping_T * yaw_rate
        if self.num_numbers is not None:
            share = (angle / self.turn).clamp(-1.0, 1.0).unsqueeze(-1)
            return tensordict.set("action", pad(share, (0, self.num_numbers - 1), value=1.0))
        side = torch.full_like(angle, KEEP, dtype=torch.int64)
        side[angle > 0.5 * self.turn] = COUNTER_CLOCKWISE
        side[angle < -0.5 * self.turn] = CLOCKWISE
        mask = tensordict["action_mask"]
        rank = torch.arange(1, mask.shape[-1] + 1, device=mask.device)
        turns = (rank - 1) % 3 == side.unsqueeze(-1)
        return tensordict.set("action", (mask * rank * (1 + mask.shape[-1] * turns)).argmax(-1))


class PursuitPolicy(_TurningPolicy):
    """Turn towards the food whenever the bearing error exceeds half the turn of one action.

    With continuous actions the turn equals the bearing error, up to the largest one.

    Args:
        turn: heading change of one action in radians; the largest one of a continuous action.
        num_numbers: numbers in a continuous action; None for discrete actions.
    """

    def aim(self, tensordict: TensorDictBase) -> Tensor:
        """Return the bearing error."""
        bearing_error: Tensor = tensordict["observation_stack"][..., -1]
        return bearing_error


class InterceptPolicy(_TurningPolicy):
    """Steer to the earliest point at which the fish can meet the food, whose path is known.

    Heading follows from each observation (direction of the food minus bearing error), the path from
    ``food_ahead``, which the task reports: the food's places ``[B, K, 2]`` from now on, every
    ``LEAD_T``, in body lengths. The controller picks the earliest meeting point that a turn of
    radius ``turn_radius_bl`` followed by a straight line reaches in time (Dubins 1957: shortest
    paths of bounded curvature, free final heading). Points inside the turning circle are out of
    reach, so a later one is chosen.

    Args:
        speed_bl: cruising speed of the fish, L / T.
        turn_radius_bl: radius of its tightest turn.
        turn: see ``PursuitPolicy``.
        num_numbers: see ``PursuitPolicy``.
    """

    def __init__(
        self,
        *,
        speed_bl: float = 0.4,
        turn_radius_bl: float = 1.7,
        turn: float = math.radians(15.0),
        num_numbers: int | None = None,
        yaw_damping_T: float = 0.0,
    ) -> None:
        super().__init__(turn=turn, num_numbers=num_numbers, yaw_damping_T=yaw_damping_T)
        self.in_keys.append("food_ahead")
        self.speed_bl, self.turn_radius_bl = speed_bl, turn_radius_bl

    def aim(self, tensordict: TensorDictBase) -> Tensor:
        """Return the turn of the shortest path to the meeting point."""
        x, y, _, error = tensordict["observation_stack"][..., -NUM_FEATURES:, None].unbind(-2)
        heading = torch.atan2(y, x) - error
        path = tensordict["food_ahead"]
        lead = LEAD_T * torch.arange(path.shape[-2], device=path.device)
        move_x, move_y = (path - path[..., :1, :]).unbind(-1)
        x, y, cos, sin = x + move_x, y + move_y, heading.cos(), heading.sin()
        # From here on in the frame of the nose now.
        length, angle = _shortest_path(cos * x + sin * y, cos * y - sin * x, self.turn_radius_bl)
        is_in_time = length <= self.speed_bl * lead
        # Earliest meeting point; where there is none, the one missed by the least time.
        delay = torch.where(is_in_time, lead - lead[-1], length / self.speed_bl - lead)
        return angle.gather(-1, delay.argmin(-1, keepdim=True)).squeeze(-1)


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
