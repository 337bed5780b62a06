"""A hand-crafted controller that keeps a fish at a place behind its leader.

It reads the same TensorDict as a learned policy: a stack of observations whose first three numbers
are x and y behind the leader in body lengths and the heading from upstream in radians, and whose
numbers 7 to 9 are the velocity (x, y) in L / T and the turning rate in radians per T.
"""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch.nn.functional import pad

STATION_BL = 1.75  # x to keep, body lengths
FREQUENCY = 1.1  # at the station, beats per T
GAIN = 0.6  # of the frequency, beats per T and body length
DAMPING = 1.0  # of the frequency, beats per L
ASIDE_GAIN = 0.8  # heading for a distance aside of 1 L, radians
ASIDE_DAMPING = 1.0  # the same for 1 L / T
SPIN_GAIN = 0.2  # heading for a yaw rate of 1 rad / T, radians


class KeepPlace(TensorDictModuleBase):
    """Beat faster when too far behind, and head for the centreline when off it.

    Decisions are half a beat apart; the mean of two observations is without the sway of the beat.

    Args:
        bend_bl: largest bend of an action, body lengths; 1 L for an error in heading of 1 radian.
        frequency_range: least and largest frequency of an action, beats per T.
        num_actions: 3 for actions with an amplitude, which is kept at its largest.
    """

    def __init__(
        self, *, bend_bl: float, frequency_range: tuple[float, float], num_actions: int = 2
    ) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation_stack"], ["action"]
        self.bend_bl, self.num_actions = bend_bl, num_actions
        self.frequency_range = frequency_range

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B, num_actions]``: bend, frequency, amplitude, each in [-1, 1]."""
        num_features = 10 + 2 * self.num_actions  # the last two actions are observed
        stack = tensordict["observation_stack"].unflatten(-1, (-1, num_features))
        x, y, heading = stack[..., -2:, :3].mean(-2).unbind(-1)
        velocity_x, velocity_y, spin = stack[..., -2:, 7:10].mean(-2).unbind(-1)
        # a heading above upstream leads to -y
        course = ASIDE_GAIN * y + ASIDE_DAMPING * velocity_y
        error = course.clamp(-0.4, 0.4) - heading
        bend = (error - SPIN_GAIN * spin) / self.bend_bl
        low, high = self.frequency_range
        frequency = FREQUENCY + GAIN * (x - STATION_BL) + DAMPING * velocity_x
        share = 2.0 * (frequency - low) / (high - low) - 1.0
        action = torch.stack((bend, share), -1).clamp(-1.0, 1.0)
        return tensordict.set("action", pad(action, (0, self.num_actions - 2), value=1.0))
