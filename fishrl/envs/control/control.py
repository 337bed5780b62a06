"""The interface of an action space, see ``Control``."""

from abc import ABC, abstractmethod
from itertools import pairwise
from typing import Annotated, NamedTuple

import torch
from pydantic import AfterValidator, Field, NonNegativeFloat
from torch import Tensor

from fishrl.physics.bodies.motion import Commanded, Motion
from fishrl.settings import Settings


def _check_rising(row: tuple[float, ...]) -> tuple[float, ...]:
    if not all(low < high for low, high in pairwise(row)):
        raise ValueError("rising")
    return row


#: In the annotation of a tuple: its numbers rise.
Rising = AfterValidator(_check_rising)
Row = Annotated[tuple[NonNegativeFloat, ...], Field(min_length=2), Rising]


class Choice(NamedTuple):
    """Gear, tail beat and steering that an action chooses; ``[B]``, or ``[B, M]`` of M fish."""

    gear: Tensor  #: index into a row of frequencies from now on, int64
    frequency: Tensor  #: tail beats per T, float64
    amplitude: Tensor | None = None  #: share of the gait's amplitude, 0 to 1; None keeps it
    turn: Tensor | None = None  #: change of heading in radians, positive to the left
    bend: Tensor | None = None  #: deflection of the tail in L, positive for a turn to the left


class Control(Settings, ABC):
    """Map actions to turns or bends, and to the tail beat.

    Discrete actions that turn or bend run from right (clockwise, negative) to left. A controller
    has no state: a task keeps the *gear* of each fish, an index into a row of frequencies.
    """

    @property
    @abstractmethod
    def action_names(self) -> tuple[str, ...]:
        """Names of the actions in their order, or of the components of a continuous one."""

    @property
    def num_actions(self) -> int:
        """Number of actions, or of the components of a continuous one."""
        return len(self.action_names)

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """Bounds of a continuous action, see ``AbstractTask``; None if actions are discrete."""
        return None

    @property
    def mirrored_actions(self) -> tuple[int, ...]:
        """Mirror images of the actions, see ``Mirror``; by default each its own.

        Raises:
            ValueError: if actions steer and their mirror images are not given.
        """
        if self.largest_turn or self.largest_bend:
            raise ValueError(f"reflect: {type(self).__name__} steers; give its mirrored_actions")
        return (
            tuple(range(self.num_actions))
            if self.action_bounds is None
            else ((1,) * self.num_actions)
        )

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Frequencies by gear, tail beats per T: a row per flow, or one for all flows."""
        return ((1.0,),)

    @property
    def max_frequency(self) -> float:
        """Highest frequency of all rows, tail beats per T."""
        return max(row[-1] for row in self.rows)

    @property
    def num_flows(self) -> int | None:
        """Number of rows; None, the default, if the frequency does not depend on the flow."""
        return None

    @property
    def start_gear(self) -> int:
        """Initial gear."""
        return 0

    @property
    def largest_turn(self) -> float:
        """Largest turn, radians; 0, the default, if actions do not turn the fish."""
        return 0.0

    @property
    def largest_bend(self) -> float:
        """Largest bend, body lengths; 0, the default, if actions do not bend the fish."""
        return 0.0

    def make_motion(self, interval_T: float) -> Motion:
        """Return the motion of a fish with one decision per ``interval_T``."""
        return Commanded()

    @abstractmethod
    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        """Return the choice of legal actions ``[B]``, ``[B, n]`` if continuous.

        ``gear`` ``[B]``, int64, is the gear before the action. ``flow`` ``[B]`` is the flow label;
        one between two whole numbers interpolates between the frequencies of their rows.
        """

    def mask(self, gear: Tensor) -> Tensor:
        """Return the legal actions ``[B, num_actions]``, bool; by default all."""
        return torch.ones(*gear.shape, self.num_actions, dtype=torch.bool, device=gear.device)
