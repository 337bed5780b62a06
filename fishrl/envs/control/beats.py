"""Control of the tail-beat frequency: none, macro-actions, direct choice, or a continuous one.

Macro-actions (as in the paper) have one row of frequencies per flow, in which a gear has a similar
effect in each flow: gear 0 drifts downstream, the last one swims upstream. When the flow label
changes, the gear stays and the row switches.
"""

from typing import Annotated, ClassVar

import torch
from pydantic import Field, NonNegativeFloat, NonNegativeInt
from torch import Tensor

from fishrl.envs.constants import make_constant
from fishrl.envs.control.control import Choice, Control, Rising, Row

#: For the paper's three flows, from ``studies/drift_sweep``. In each row the
#: second frequency is the shedding frequency, which roughly holds station, and the last one swims
#: upstream.
DEFAULT_ROWS = (
    (0.25, 0.53, 1.0, 1.5, 2.1),
    (0.3, 0.66, 1.1, 1.65, 2.25),
    (0.4, 0.78, 1.3, 1.9, 2.6),
)
_Share = Annotated[float, Field(ge=0, le=1)]


class Steady(Control):
    """One tail beat per T, without a choice."""

    action_names: ClassVar[tuple[str, ...]] = ("",)

    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        """Return the frequency 1."""
        return Choice(gear, torch.ones_like(gear, dtype=torch.float64))


class MacroActions(Control):
    """Decelerate (0), cruise (1) or accelerate (2): shift by one gear in the row of the flow.

    Decelerating is illegal in the first gear, accelerating in the last.

    Args:
        rows: tail beats per T, rising, all of the same length: one row per flow, or one for all.
        first_gear: initial gear, counted from 0; by default the middle one.
    """

    action_names: ClassVar[tuple[str, ...]] = ("decelerate", "cruise", "accelerate")

    rows: Annotated[tuple[Row, ...], Field(min_length=1)] = DEFAULT_ROWS
    first_gear: NonNegativeInt | None = None

    def __post_init__(self) -> None:
        if len({len(row) for row in self.rows}) > 1:
            raise ValueError(
                f"rows have {[len(row) for row in self.rows]} frequencies: give all the same number"
            )
        if self.start_gear >= (num := len(self.rows[0])):
            raise ValueError(f"first_gear = {self.first_gear}: allowed is 0 to {num - 1}")

    @property
    def num_flows(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @property
    def start_gear(self) -> int:
        """Initial gear."""
        return (len(self.rows[0]) - 1) // 2 if self.first_gear is None else self.first_gear

    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        """Return the shifted gear, and its frequency in the row of the flow."""
        gear, flow = gear + action - 1, flow.clamp(0, len(self.rows) - 1)
        rows, low = make_constant(self.rows, torch.float64, gear.device), flow.floor()
        below, above = (rows[each.long(), gear] for each in (low, flow.ceil()))
        return Choice(gear, below + (flow - low) * (above - below))

    def mask(self, gear: Tensor) -> Tensor:
        """Return ``[B, 3]`` bool."""
        can_slow, can_speed = gear > 0, gear < len(self.rows[0]) - 1
        return torch.stack((can_slow, torch.ones_like(can_slow), can_speed), -1)


class DirectFrequencies(Control):
    """Choose one of n frequencies directly, independent of the flow (the ablation).

    Args:
        frequencies: tail beats per T, rising; 0 is a passive fish.
    """

    frequencies: Row

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """One row, the frequencies."""
        return (self.frequencies,)

    @property
    def action_names(self) -> tuple[str, ...]:
        """The frequencies."""
        return tuple(f"{frequency:g} beats/T" for frequency in self.frequencies)

    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        """Return the action as the gear, and its frequency."""
        frequencies = make_constant(self.frequencies, torch.float64, action.device)
        return Choice(action, frequencies[action])


class ContinuousFrequency(Control):
    """Set the frequency, and the amplitude if it has a range, independent of the flow.

    Args:
        frequency_range: least and largest frequency, tail beats per T; by default the range of all
            rows of the macro-actions.
        amplitude_range: least and largest share of the gait's amplitude, at most 1; None for the
            gait's own.
    """

    frequency_range: Annotated[tuple[NonNegativeFloat, NonNegativeFloat], Rising] = (0.25, 2.6)
    amplitude_range: Annotated[tuple[_Share, _Share], Rising] | None = None

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """One row, the ends of the range."""
        return (self.frequency_range,)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Frequency, and amplitude if it has a range."""
        parts = (("frequency", " beats/T"), ("amplitude", ""))
        return tuple(
            f"{name}, {low:g} to {high:g}{unit}"
            for (name, unit), (low, high) in zip(parts, self.action_bounds, strict=False)
        )

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...]:
        """The ranges."""
        if self.amplitude_range is None:
            return (self.frequency_range,)
        return self.frequency_range, self.amplitude_range

    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        """Return the components of the action; the gear is not used."""
        frequency, *amplitude = action.unbind(-1)
        return Choice(gear, frequency, *amplitude)
