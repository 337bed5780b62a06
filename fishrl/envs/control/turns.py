"""Control of the heading, together with the tail beat: imposed turns, or bends of the body."""

from abc import abstractmethod
from math import ceil, radians
from typing import Annotated

from pydantic import Field, PositiveFloat
from torch import Tensor

from fishrl.envs.control.beats import Steady
from fishrl.envs.control.control import Choice, Control
from fishrl.physics.bodies.motion import MAX_RESPONSE, Bending, Motion

_SIDES = ("right", "straight", "left")


class _Steered(Control):
    """Base of controls of the heading; a discrete action is 3 b + s, with b an action of the beat.

    s is a turn to the right (0), none (1) or a turn to the left (2). A continuous action is the
    turn, positive to the left, and then the components of the beat.

    Args:
        beat: control of the tail beat.
    """

    beat: Control = Steady()

    def __post_init__(self) -> None:
        if self.beat.largest_turn or self.beat.largest_bend:
            raise ValueError("beat steers the fish itself: give a control of the tail beat alone")

    @property
    @abstractmethod
    def span(self) -> tuple[str, float, str]:
        """Name, largest value and unit of a turn or bend."""

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """Frequencies of the beat by gear."""
        return self.beat.rows

    @property
    def num_flows(self) -> int | None:
        """Number of rows of the beat."""
        return self.beat.num_flows

    @property
    def start_gear(self) -> int:
        """Initial gear of the beat."""
        return self.beat.start_gear

    @property
    def action_names(self) -> tuple[str, ...]:
        """Each action of the beat to each side, or the turn and the components of the beat."""
        if self.action_bounds is not None:
            name, largest, unit = self.span
            return (f"{name}, ±{largest:g}{unit}", *self.beat.action_names)
        return tuple(
            ", ".join(filter(None, (beat, side)))
            for beat in self.beat.action_names
            for side in _SIDES
        )

    @property
    def action_bounds(self) -> tuple[tuple[float, float], ...] | None:
        """Largest turns to both sides and the bounds of the beat, if that is continuous."""
        beat, largest = self.beat.action_bounds, self.span[1]
        return None if beat is None else ((-largest, largest), *beat)

    @property
    def mirrored_actions(self) -> tuple[int, ...]:
        """The same beat, steered to the other side."""
        of_beat = self.beat.mirrored_actions
        if self.action_bounds is not None:
            return (-1, *of_beat)
        return tuple(3 * beat + side for beat in of_beat for side in (2, 1, 0))

    def mask(self, gear: Tensor) -> Tensor:
        """Return the legal actions of the beat, the same to each side."""
        return self.beat.mask(gear).repeat_interleave(3, -1)

    def _split(self, action: Tensor, gear: Tensor, flow: Tensor) -> tuple[Choice, Tensor]:
        """Return the choice of the beat, and the turn ``[B]``: -1, 0 or 1, or in its unit."""
        if self.action_bounds is None:
            return self.beat.choose(action // 3, gear, flow), (action % 3).double() - 1.0
        return self.beat.choose(action[..., 1:], gear, flow), action[..., 0]


class Turn(_Steered):
    """Turn the fish by an external torque; with the default beat 0 right, 1 straight, 2 left.

    A discrete action is 3 b + s, with b an action of the beat and s one of these three. A
    continuous one is the turn in degrees, positive to the left, and the components of the beat.

    Args:
        turn_degrees: change of heading by one action, spread smoothly over the interval; the
            largest one of a continuous action.
        beat: control of the tail beat.
    """

    turn_degrees: Annotated[float, Field(gt=0, le=180)] = 15.0

    @property
    def span(self) -> tuple[str, float, str]:
        """The turn in degrees."""
        return "turn", self.turn_degrees, "°"

    @property
    def largest_turn(self) -> float:
        """Largest turn, radians."""
        return radians(self.turn_degrees)

    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        """Return the choice of the beat, and the turn."""
        choice, turn = self._split(action, gear, flow)
        is_discrete = self.action_bounds is None
        return choice._replace(turn=self.largest_turn * turn if is_discrete else turn.deg2rad())


class Bend(_Steered):
    """Bend the body, so that only the water turns the fish; actions are as in ``Turn``.

    The bend, see ``motion.Bending``, is given as the deflection of the tail. The defaults stay
    within what trout do: their tail-beat amplitude in a vortex street is almost three times that in
    a uniform stream, about 0.1 L (Akanyeti & Liao 2013, J. Exp. Biol. 216, 3442), and they turn
    within radii down to 0.18 L (Webb 1983, J. Exp. Biol. 102, 115); a bend of 0.3 L has a radius of
    curvature of 1.7 L.

    Args:
        bend_bl: largest deflection of the tail, body lengths.
        response_T: time constant with which the bend follows the command.
        beat: control of the tail beat.
    """

    bend_bl: Annotated[float, Field(gt=0, le=0.5)] = 0.3
    response_T: PositiveFloat = 0.3

    @property
    def span(self) -> tuple[str, float, str]:
        """The bend in body lengths."""
        return "bend", self.bend_bl, " L"

    @property
    def largest_bend(self) -> float:
        """Largest bend, body lengths."""
        return self.bend_bl

    def make_motion(self, interval_T: float) -> Motion:
        """Return the motion of a free fish that bends; ValueError where it could not follow."""
        if self.response_T < interval_T / MAX_RESPONSE:
            raise ValueError(
                f"response_T = {self.response_T:g}: raise it to at least "
                f"{ceil(1e3 * interval_T / MAX_RESPONSE) / 1e3:g}, 1 / {MAX_RESPONSE:g} of "
                "control_interval_T"
            )
        return Bending(response=interval_T / self.response_T)

    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        """Return the choice of the beat, and the bend."""
        choice, bend = self._split(action, gear, flow)
        is_discrete = self.action_bounds is None
        return choice._replace(bend=self.bend_bl * bend if is_discrete else bend)
