"""Action spaces for the tail-beat frequency: macro-actions, direct choice, or a continuous one.

``BendControl`` adds the bend of the body to any of them, so that a fish can turn itself.

The state is the *gear*, an index into a row of frequencies. Macro-actions (as in the paper) have
one row per flow, in which a gear has a similar effect in each flow: gear 0 drifts downstream, the
last one swims upstream. When the flow label changes, the gear stays and the row switches.
"""

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, ClassVar

import torch
from pydantic import AfterValidator, Field, NonNegativeFloat, NonNegativeInt, PositiveFloat
from torch import Tensor

from fishrl.envs.task import AbstractTask
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Bending, Commanded, Motion
from fishrl.settings import Settings

#: For the paper's three flows, from ``studies/drift_sweep``. In each row the
#: second frequency is the shedding frequency, which roughly holds station, and the last one swims
#: upstream.
DEFAULT_ROWS = (
    (0.25, 0.53, 1.0, 1.5, 2.1),
    (0.3, 0.66, 1.1, 1.65, 2.25),
    (0.4, 0.78, 1.3, 1.9, 2.6),
)


def _check_rising(row: tuple[float, ...]) -> tuple[float, ...]:
    if not all(low < high for low, high in pairwise(row)):
        raise ValueError("rising")
    return row


#: In the annotation of a tuple: its numbers rise.
Rising = AfterValidator(_check_rising)
_Row = Annotated[tuple[NonNegativeFloat, ...], Field(min_length=2), Rising]


class FrequencyControl(Settings, ABC):
    """Map actions to tail-beat frequencies.

    Args:
        first_gear: initial gear, counted from 0; by default the middle one.
    """

    first_gear: NonNegativeInt | None = None

    def __post_init__(self) -> None:
        if self.first_gear is not None and self.first_gear >= self.num_gears:
            raise ValueError(
                f"first_gear = {self.first_gear}: allowed is 0 to {self.num_gears - 1}"
            )

    @property
    @abstractmethod
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Frequencies by gear, tail beats per T: a row per flow, or one for all flows."""

    @property
    @abstractmethod
    def action_names(self) -> tuple[str, ...]:
        """Names of the actions, in their order."""

    @property
    def num_flows(self) -> int | None:
        """Number of rows; None, the default, if the frequency does not depend on the flow."""
        return None

    @property
    def num_gears(self) -> int:
        """Number of frequencies in each row."""
        return len(self.rows[0])

    @property
    def num_actions(self) -> int:
        """Number of actions."""
        return len(self.action_names)

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """Bounds of a continuous action, see ``AbstractTask``; None if actions are discrete."""
        return None

    @property
    def max_frequency(self) -> float:
        """Highest frequency of all rows, tail beats per T."""
        return max(row[-1] for row in self.rows)

    @property
    def start_gear(self) -> int:
        """Initial gear."""
        return (self.num_gears - 1) // 2 if self.first_gear is None else self.first_gear

    @abstractmethod
    def choose(self, gear: Tensor, action: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """Return gear ``[B]``, int64, and tail beats per T ``[B]``, float64, after legal actions.

        Gears before them and flow labels are ``[B]``, actions too, ``[B, 1]`` if continuous.
        """

    @property
    def bend_bl(self) -> float:
        """Largest bend; 0, the default, if a heading controller turns the fish."""
        return 0.0

    @property
    def bend_rate_bl(self) -> float:
        """Largest speed of the tail due to the bend, L / T."""
        return 0.0

    def make_motion(self, interval_T: float) -> Motion:
        """Return what moves a fish with one decision per ``interval_T``."""
        return Commanded()

    def bend(self, action: Tensor) -> Tensor | None:
        """Return the commanded bend ``[B]`` in L, float64, positive for a turn to the left.

        None, the default, leaves the turn to a heading controller.
        """
        return None

    def mask(self, gear: Tensor) -> Tensor:
        """Return the legal actions ``[B, num_actions]``, bool; by default all."""
        return torch.ones(*gear.shape, self.num_actions, dtype=torch.bool, device=gear.device)


class MacroActions(FrequencyControl):
    """Decelerate (0), cruise (1) or accelerate (2): shift by one gear in the row of the flow.

    Decelerating is illegal in the first gear, accelerating in the last. A flow label between two
    whole numbers interpolates between the frequencies of their rows.

    Args:
        rows: tail beats per T, rising, all of the same length: one row per flow, or one for all.
    """

    action_names: ClassVar[tuple[str, ...]] = ("decelerate", "cruise", "accelerate")

    rows: Annotated[tuple[_Row, ...], Field(min_length=1)] = DEFAULT_ROWS

    def __post_init__(self) -> None:
        if len({len(row) for row in self.rows}) > 1:
            raise ValueError(
                f"rows have {[len(row) for row in self.rows]} frequencies: give all the same number"
            )
        super().__post_init__()

    @property
    def num_flows(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def choose(self, gear: Tensor, action: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """Return the shifted gear, and its frequency in the row of the flow."""
        gear, flow = gear + action - 1, flow.clamp(max=len(self.rows) - 1)
        rows, low = torch.tensor(self.rows, dtype=torch.float64, device=gear.device), flow.floor()
        below, above = (rows[each.long(), gear] for each in (low, flow.ceil()))
        return gear, below + (flow - low) * (above - below)

    def mask(self, gear: Tensor) -> Tensor:
        """Return ``[B, 3]`` bool."""
        can_slow, can_speed = gear > 0, gear < self.num_gears - 1
        return torch.stack((can_slow, torch.ones_like(can_slow), can_speed), -1)


class DirectFrequencies(FrequencyControl):
    """Choose one of n frequencies directly, independent of the flow (the ablation).

    Args:
        frequencies: tail beats per T, rising; 0 is a passive fish.
    """

    frequencies: _Row

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """The only row."""
        return (self.frequencies,)

    @property
    def action_names(self) -> tuple[str, ...]:
        """The frequencies."""
        return tuple(f"{frequency:g} beats/T" for frequency in self.frequencies)

    def choose(self, gear: Tensor, action: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """Return the action itself as the gear, and its frequency."""
        frequencies = torch.tensor(self.frequencies, dtype=torch.float64, device=action.device)
        return action, frequencies[action]


class ContinuousFrequency(FrequencyControl):
    """Set the frequency directly, independent of the flow; the gear is not used and stays 0.

    Args:
        frequency_range: least and largest frequency, tail beats per T; by default the
            range of all rows of the macro-actions.
    """

    frequency_range: Annotated[tuple[NonNegativeFloat, NonNegativeFloat], Rising] = (0.25, 2.6)

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """The ends of the range."""
        return (self.frequency_range,)

    @property
    def action_names(self) -> tuple[str, ...]:
        """The only number."""
        low, high = self.frequency_range
        return (f"frequency, {low:g} to {high:g} beats/T",)

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...]:
        """The range."""
        return (self.frequency_range,)

    def choose(self, gear: Tensor, action: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gear as it is, and the action ``[B, 1]`` as the frequency ``[B]``."""
        return gear, action.squeeze(-1)


class BendControl(FrequencyControl):
    """Bend the body as well as choosing the tail beat; only the water turns the fish.

    A discrete action is 3 b + t, with b an action of ``beat`` and t a bend to the left (0), none
    (1) or a bend to the right (2). A continuous one is the bend in L, positive to the left, and the
    frequency.

    The bend is that of ``motion.Bending``, given as the deflection of the tail. The defaults stay
    within what trout do: their tail-beat amplitude in a vortex street is almost three times that in
    a uniform stream, about 0.1 L (Akanyeti & Liao 2013, J. Exp. Biol. 216, 3442), and they turn
    within radii down to 0.18 L (Webb 1983, J. Exp. Biol. 102, 115); a bend of 0.3 L has a radius of
    curvature of 1.7 L.

    Args:
        beat: control of the tail beat.
        bend_bl: largest deflection of the tail, body lengths.
        response_T: time constant with which the bend follows the command.
    """

    beat: FrequencyControl = MacroActions()
    bend_bl: Annotated[float, Field(gt=0, le=0.5)] = 0.3
    response_T: PositiveFloat = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.beat.bend_bl:
            raise ValueError("beat bends the body itself: give a control of the tail beat alone")

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Those of ``beat``."""
        return self.beat.rows

    @property
    def num_flows(self) -> int | None:
        """As of ``beat``."""
        return self.beat.num_flows

    @property
    def start_gear(self) -> int:
        """As of ``beat``, unless ``first_gear`` is given here."""
        return self.beat.start_gear if self.first_gear is None else self.first_gear

    @property
    def action_names(self) -> tuple[str, ...]:
        """Each action of ``beat`` with each bend, or the bend and the number of ``beat``."""
        if self.action_bounds is not None:
            return (f"bend, ±{self.bend_bl:g} L", *self.beat.action_names)
        turns = ("left", "straight", "right")
        return tuple(f"{beat}, {turn}" for beat in self.beat.action_names for turn in turns)

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """The largest bends and the range of ``beat``, if that is continuous."""
        beat = self.beat.action_bounds
        return None if beat is None else ((-self.bend_bl, self.bend_bl), *beat)

    @property
    def bend_rate_bl(self) -> float:
        """That from one side to the other."""
        return 2.0 * self.bend_bl / self.response_T

    def make_motion(self, interval_T: float) -> Motion:
        """Return the motion of a free fish that bends."""
        return Bending(response=interval_T / self.response_T)

    def bend(self, action: Tensor) -> Tensor:
        """Return the bend."""
        if self.action_bounds is not None:
            return action[:, 0]
        return self.bend_bl * (1.0 - (action % 3).double())

    def choose(self, gear: Tensor, action: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """Return what ``beat`` chooses."""
        own = action // 3 if self.action_bounds is None else action[:, 1:]
        return self.beat.choose(gear, own, flow)

    def mask(self, gear: Tensor) -> Tensor:
        """Return that of ``beat``, the same for each bend."""
        return self.beat.mask(gear).repeat_interleave(3, -1)


class AbstractFrequencyTask(AbstractTask):
    """A task whose actions choose the tail-beat frequency.

    Args:
        control: maps actions to tail-beat frequencies, and bends the fish if it can; its rows are
            in the order of the flows.
    """

    control: FrequencyControl = MacroActions()

    @property
    def num_actions(self) -> int:
        """Number of actions, or of the numbers in one."""
        return self.control.num_actions

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names given by ``control``."""
        return self.control.action_names

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """Bounds given by ``control``."""
        return self.control.action_bounds

    @property
    def max_frequency(self) -> float:
        """Highest frequency of ``control``."""
        return self.control.max_frequency

    @property
    def swimming_speed(self) -> float:
        """Bound on the speed of a marker, with a bend from one side to the other."""
        return super().swimming_speed + self.control.bend_rate_bl * self.scales.reference_speed

    @property
    def largest_turn(self) -> float:
        """Largest turn of an action, radians, or its largest bend."""
        return self.control.bend_bl or super().largest_turn

    @cached_property
    def fish(self) -> Fish:
        """The fish, moved as ``control`` says."""
        return replace(super().fish, motion=self.control.make_motion(self.control_interval_T))
