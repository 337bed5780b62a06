"""How the speed of a stream changes within an episode.

A change begins with the first decision at or after its time and lasts ``ramp_T``, in which the
speed follows half a cosine, so that the water is accelerated without a shock. Speeds depend on a
key of the episode: they are the same in any batch.
"""

from math import ceil
from typing import Annotated

import torch
from pydantic import Field, PositiveFloat
from torch import Tensor

from fishrl.envs.constants import make_constant
from fishrl.envs.draws import draw_uniform
from fishrl.settings import Settings

_DRAW = 2  # the lateral line uses 0 and 1


class StreamSwitches(Settings):
    """Switches at equal intervals to another of several speeds, each with equal probability.

    Args:
        ramp_T: duration of a change.
        interval_T: time between two changes, and before the first one.
        speeds_bl: speeds of the stream, L / T.
    """

    ramp_T: PositiveFloat = 1.0
    interval_T: PositiveFloat = 20.0
    speeds_bl: Annotated[tuple[PositiveFloat, ...], Field(min_length=2)] = (1.0, 1.25, 1.5)

    def __post_init__(self) -> None:
        if self.interval_T < self.ramp_T:
            raise ValueError(
                f"interval_T = {self.interval_T}, ramp_T = {self.ramp_T}: a change must end before "
                "the next one begins; raise interval_T or lower ramp_T"
            )
        if len(set(self.speeds_bl)) < len(self.speeds_bl):
            raise ValueError(f"speeds_bl = {self.speeds_bl}: must be distinct")

    def list_times(self, num: int) -> list[float]:
        """Return when the first ``num`` changes begin, in T."""
        return [self.interval_T * (k + 1) for k in range(num)]

    def draw_speeds(self, first: Tensor, key: Tensor, duration_T: float) -> Tensor:
        """Return the speeds ``[E, K]`` that the K changes of an episode lead to, L / T, float64.

        ``first`` ``[E]`` are the speeds at the start, ``key`` ``[E]`` int64 keys of the episodes.
        """
        speeds = make_constant(self.speeds_bl, torch.float64, key.device)
        num = ceil(duration_T / self.interval_T - 1e-9) - 1
        chances = draw_uniform(_DRAW, key, torch.zeros_like(key), num)
        drawn, now = [], first.double()
        for chance in chances.unbind(-1):
            is_other = speeds != now[:, None]
            rank = (chance * is_other.sum(-1)).long()
            chosen = is_other & (is_other.cumsum(-1) == rank[:, None] + 1)
            now = speeds[chosen.int().argmax(-1)]
            drawn.append(now)
        return torch.stack(drawn, -1) if drawn else chances
