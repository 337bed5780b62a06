"""Hand-crafted controllers that hold station by the tail-beat frequency, and by the bend.

They read what the task reports, whether or not a learned policy observes it: ``place`` ``[B, 2]``,
x and y of the nose behind the obstacle, and ``drift`` ``[B, 2]``, its change since the last
decision, in body lengths. A ``FrequencyController`` commands a frequency (beats per T);
``GaitPolicy`` takes the action that comes nearest to it.
"""

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn.functional import pad

#: Maps what a policy reads, ``[B]``, and the flow label ``[B]``, an index, to the commanded
#: frequency ``[B]`` in beats per T, float64; may be infinite.
FrequencyController = Callable[[TensorDictBase, Tensor], Tensor]
STATION_BL = 2.1  # x to keep, body lengths
_HEADING = ("facing", "yaw_rate")


class FixedFrequency:
    """Command a constant frequency; 0 is a passive fish.

    Args:
        frequency: beats per T, one number or one per flow.
    """

    def __init__(self, frequency: float | Sequence[float]) -> None:
        self.frequency = torch.as_tensor(frequency, dtype=torch.float64)

    def __call__(self, tensordict: TensorDictBase, flow: Tensor) -> Tensor:
        """Return the frequency."""
        frequency = self.frequency.to(flow.device)
        return frequency[flow] if frequency.dim() else frequency.expand(flow.shape)


def bang_bang(tensordict: TensorDictBase, flow: Tensor) -> Tensor:
    """Command infinity downstream of the station, x > ``STATION_BL``, and 0 upstream of it."""
    is_behind = tensordict["place"][..., 0] > STATION_BL
    return torch.where(is_behind, torch.inf, 0.0).double()


class PID:
    """PID control of the streamwise position.

    Args:
        station_bl: setpoint of x, body lengths, one number or ``[B]``.
        frequency: beats per T at zero error, one number or one per flow.
        gain: beats per T and body length.
        integral_gain: beats per T, body length and decision.
        damping: derivative gain, beats per T for one body length per decision.
        max_sum: bound of the summed error, body lengths (anti-windup).
    """

    def __init__(
        self,
        *,
        station_bl: float | Tensor = STATION_BL,
        frequency: float | Sequence[float] = 1.0,
        gain: float = 2.0,
        integral_gain: float = 0.0,
        damping: float = 5.0,
        max_sum: float = 5.0,
    ) -> None:
        self.station_bl = station_bl
        self.frequency = torch.as_tensor(frequency, dtype=torch.float64)
        self.gain, self.integral_gain, self.damping = gain, integral_gain, damping
        self.max_sum = max_sum
        self._sum = torch.zeros(())

    def __call__(self, tensordict: TensorDictBase, flow: Tensor) -> Tensor:
        """Return the frequency; ``is_init`` resets the sum."""
        offset = tensordict["place"][..., 0].float() - self.station_bl
        change = tensordict["drift"][..., 0].float()
        is_new = tensordict["is_init"].reshape(offset.shape)
        before = self._sum if self._sum.shape == offset.shape else torch.zeros_like(offset)
        total = offset + torch.where(is_new, torch.zeros_like(offset), before)
        self._sum = total.clamp(-self.max_sum, self.max_sum)
        frequency = self.frequency.to(flow.device)
        frequency = frequency[flow] if frequency.dim() else frequency
        proportional: Tensor = frequency + self.gain * offset + self.damping * change
        return (proportional + self.integral_gain * self._sum).double()


class KeepCourse:
    """PD control of the heading by the bend: upstream, and back to the centreline.

    The target heading differs from upstream by gains times the lateral offset and its change; the
    bend is proportional to the difference from it, less the damping of the yaw rate.

    Args:
        gain: radians per body length of offset.
        damping: radians for one body length per T.
        max_angle: largest angle between target heading and upstream, radians.
        bend_gain: share of the largest bend per radian.
        yaw_damping: share of the largest bend per radian per T.
        interval_T: time between decisions.
    """

    def __init__(
        self,
        *,
        gain: float = 0.6,
        damping: float = 0.3,
        max_angle: float = 0.5,
        bend_gain: float = 3.0,
        yaw_damping: float = 0.3,
        interval_T: float = 0.125,
    ) -> None:
        self.gain, self.damping, self.max_angle = gain, damping, max_angle
        self.bend_gain, self.yaw_damping, self.interval_T = bend_gain, yaw_damping, interval_T

    def __call__(self, tensordict: TensorDictBase) -> Tensor:
        """Return the share of the largest bend ``[B]`` in [-1, 1], positive to the left."""
        offset, change = tensordict["place"][..., 1], tensordict["drift"][..., 1]
        facing, yaw_rate = (tensordict[name].reshape(offset.shape) for name in _HEADING)
        aim = self.gain * offset + self.damping * change / self.interval_T
        error = aim.clamp(-self.max_angle, self.max_angle) - facing  # a heading above 0 leads to -y
        share: Tensor = self.bend_gain * error - self.yaw_damping * yaw_rate
        return share.clamp(-1.0, 1.0)


class GaitPolicy(TensorDictModuleBase):
    """Take the legal action that comes nearest to the commanded frequency, and bend.

    Args:
        controller: commands the frequency.
        course: commands the bend where actions have one, as ``KeepCourse`` does; None where they
            have not.
        rows: available frequencies, rising, one row per flow; one row with ``is_direct``, whose
            ends are the range of a continuous action.
        is_direct: actions are indices into the only row; otherwise decelerate (0), cruise (1) or
            accelerate (2) from the current ``gear``.
        num_numbers: numbers in a continuous action: the bend, if any, the frequency, mapped to
            [-1, 1], and others, kept at their largest; None for discrete actions.
        flow_key: key of the row to use: ``flow_index``, or the predicted ``flow_class``.
    """

    def __init__(
        self,
        *,
        controller: FrequencyController,
        course: Callable[[TensorDictBase], Tensor] | None = None,
        rows: Sequence[Sequence[float]],
        is_direct: bool = False,
        num_numbers: int | None = None,
        flow_key: str = "flow_index",
    ) -> None:
        super().__init__()
        self.controller, self.is_direct, self.flow_key = controller, is_direct, flow_key
        self.course, self.num_numbers = course, num_numbers
        self.in_keys = ["place", "drift", *_HEADING, "is_init", "gear", flow_key]
        self.out_keys = ["action"]
        self.rows = torch.tensor(rows, dtype=torch.float64)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]``, or ``[B, n]`` if continuous; it is always legal."""
        batch = tensordict.batch_size
        flow = tensordict[self.flow_key].reshape(batch).round().long()  # or a mean label
        rows = self.rows.to(flow.device)
        wanted = self.controller(tensordict, flow).clamp(rows.min(), rows.max())
        if self.num_numbers is not None:
            share = (wanted - rows.min()) / (rows.max() - rows.min())
            bend = [] if self.course is None else [self.course(tensordict)]
            action = torch.stack((*bend, 2.0 * share - 1.0), -1).float()
            more = self.num_numbers - action.shape[-1]
            return tensordict.set("action", pad(action, (0, more), value=1.0))
        row = rows[0].expand(*batch, -1) if self.is_direct else rows[flow]
        action = (row - wanted[..., None]).abs().argmin(-1)
        if not self.is_direct:
            action = 1 + (action - tensordict["gear"].reshape(batch)).sign()
        if self.course is not None:
            action = 3 * action + 1 + self.course(tensordict).round().long()
        return tensordict.set("action", action)
