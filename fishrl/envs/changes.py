"""How the speed of a stream changes within an episode: at given times, or at random.

A change begins with the first decision at or after its time and lasts ``ramp_T``, in which the
speed follows half a cosine, so that the water is accelerated without a shock. Random speeds depend
on a key of the episode: they are the same in any batch.
"""

from abc import ABC, abstractmethod
from itertools import pairwise
from math import ceil
from typing import Annotated

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat
from torch import Tensor

from fishrl.envs.draws import draw_uniform
from fishrl.settings import Settings

_DRAW = 2  # the lateral line uses 0 and 1


class StreamChanges(Settings, ABC):
    """Changes of a stream's speed.

    Args:
        ramp_T: duration of a change.
    """

    ramp_T: PositiveFloat = 1.0

    @property
    @abstractmethod
    def range_bl(self) -> tuple[float, float]:
        """Slowest and fastest speed that a change leads to, L / T."""

    @abstractmethod
    def list_times(self, num: int) -> list[float]:
        """Return when the first ``num`` changes begin, in T."""

    @abstractmethod
    def draw_speeds(self, first: Tensor, key: Tensor, duration_T: float) -> Tensor:
        """Return the speeds ``[E, K]`` that the K changes of an episode lead to, L / T, float64.

        Args:
            first: ``[E]`` speed at the start, L / T.
            key: ``[E]`` int64, key of the episode.
            duration_T: duration of the episode.
        """


class StreamSteps(StreamChanges):
    """The same changes in every episode; with a longer ``ramp_T`` they are ramps.

    Args:
        times_T: when they begin, rising; each after the one before has ended.
        speeds_bl: speeds that they lead to, L / T.
    """

    times_T: Annotated[tuple[NonNegativeFloat, ...], Field(min_length=1)]
    speeds_bl: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.times_T) != len(self.speeds_bl):
            raise ValueError(
                f"times_T has {len(self.times_T)} entries, speeds_bl {len(self.speeds_bl)}: give "
                "one speed for each time"
            )
        if any(after - before < self.ramp_T for before, after in pairwise(self.times_T)):
            raise ValueError(
                f"times_T = {self.times_T}, ramp_T = {self.ramp_T}: times must rise, each by at "
                "least ramp_T, the duration of a change"
            )

    @property
    def range_bl(self) -> tuple[float, float]:
        """Slowest and fastest of the speeds."""
        return min(self.speeds_bl), max(self.speeds_bl)

    def list_times(self, num: int) -> list[float]:
        """Return the times."""
        return list(self.times_T[:num])

    def draw_speeds(self, first: Tensor, key: Tensor, duration_T: float) -> Tensor:
        """Return the speeds, regardless of the duration."""
        speeds = torch.tensor(self.speeds_bl, dtype=torch.float64, device=key.device)
        return speeds.expand(len(key), -1).clone()


class RandomChanges(StreamChanges):
    """Changes at equal intervals.

    Args:
        interval_T: time between two changes, and before the first one.
    """

    interval_T: PositiveFloat = 20.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.interval_T < self.ramp_T:
            raise ValueError(
                f"interval_T = {self.interval_T}, ramp_T = {self.ramp_T}: a change must end before "
                "the next one begins; raise interval_T or lower ramp_T"
            )

    def list_times(self, num: int) -> list[float]:
        """Return multiples of the interval."""
        return [self.interval_T * (k + 1) for k in range(num)]

    def draw_chances(self, key: Tensor, duration_T: float) -> Tensor:
        """Return a number ``[E, K]`` in [0, 1) for each change before the end of the episode."""
        num = ceil(duration_T / self.interval_T - 1e-9) - 1
        return draw_uniform(_DRAW, key, torch.zeros_like(key), num)


class StreamSwitches(RandomChanges):
    """Switches to another of several speeds, each with equal probability.

    Args:
        speeds_bl: speeds of the stream, L / T.
    """

    speeds_bl: Annotated[tuple[PositiveFloat, ...], Field(min_length=2)] = (1.0, 1.25, 1.5)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(set(self.speeds_bl)) < len(self.speeds_bl):
            raise ValueError(f"speeds_bl = {self.speeds_bl}: must differ from each other")

    @property
    def range_bl(self) -> tuple[float, float]:
        """Slowest and fastest of the speeds."""
        return min(self.speeds_bl), max(self.speeds_bl)

    def draw_speeds(self, first: Tensor, key: Tensor, duration_T: float) -> Tensor:
        """Draw each speed from those that differ from the speed before."""
        speeds = torch.tensor(self.speeds_bl, dtype=torch.float64, device=key.device)
        chances = self.draw_chances(key, duration_T)
        drawn, now = [], first.double()
        for chance in chances.unbind(-1):
            is_other = speeds != now[:, None]
            rank = (chance * is_other.sum(-1)).long()
            chosen = is_other & (is_other.cumsum(-1) == rank[:, None] + 1)
            now = speeds[chosen.int().argmax(-1)]
            drawn.append(now)
        return torch.stack(drawn, -1) if drawn else chances


class StreamWalk(RandomChanges):
    """A random walk: each change is drawn uniformly, and reflected at the limits.

    Args:
        step_bl: largest change, L / T.
        low_bl: slowest speed, L / T.
        high_bl: fastest speed, L / T.
    """

    interval_T: float = 2.0
    step_bl: PositiveFloat = 0.2
    low_bl: PositiveFloat = 0.9
    high_bl: PositiveFloat = 1.6

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.step_bl <= self.high_bl - self.low_bl:
            raise ValueError(
                f"low_bl = {self.low_bl}, high_bl = {self.high_bl}, step_bl = {self.step_bl}: "
                "high_bl must exceed low_bl by at least step_bl"
            )

    @property
    def range_bl(self) -> tuple[float, float]:
        """The limits."""
        return self.low_bl, self.high_bl

    def draw_speeds(self, first: Tensor, key: Tensor, duration_T: float) -> Tensor:
        """Draw the walk; a start beyond the limits is moved to the nearer one first."""
        changes = self.step_bl * (2.0 * self.draw_chances(key, duration_T) - 1.0)
        drawn, now = [], first.double().clamp(self.low_bl, self.high_bl)
        for change in changes.unbind(-1):
            now = now + change
            now = torch.where(now > self.high_bl, 2.0 * self.high_bl - now, now)
            now = torch.where(now < self.low_bl, 2.0 * self.low_bl - now, now)
            drawn.append(now)
        return torch.stack(drawn, -1) if drawn else changes
