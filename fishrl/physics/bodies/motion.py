"""What moves a body: nothing, a prescribed motion, a command or the flow."""

from math import hypot, pi
from typing import Annotated, ClassVar

import torch
from pydantic import Field, PositiveInt
from torch import Tensor

from fishrl.physics.bodies.state import BodyState
from fishrl.physics.lattice import MAX_IMPOSED_SPEED
from fishrl.settings import Settings

#: Most time constants of a bend in a command.
MAX_RESPONSE = 6.0


def compute_turn_rate(body: BodyState) -> Tensor:
    """Return the commanded Omega ``[B]``: (turn / n) (1 - cos 2 pi t / n); its sum is ``turn``."""
    swing = 1.0 - torch.cos(2.0 * pi * (body.turn_clock + 0.5) / body.turn_steps)
    rate = body.turn / body.turn_steps * swing
    return torch.where(body.turn_clock < body.turn_steps, rate, torch.zeros_like(rate))


class Motion(Settings):
    """What moves a body.

    Attributes:
        free_axes: rates that the flow determines: 0 and 1 are the velocity of the centre of mass
            along x and y, 2 is Omega.
        is_still: whether the body never leaves its place.
        holds_x: whether it keeps the velocity along x that its state has.
    """

    free_axes: ClassVar[tuple[int, ...]] = ()
    is_still: ClassVar[bool] = False
    holds_x: ClassVar[bool] = False

    def prescribe(self, body: BodyState) -> tuple[Tensor, Tensor]:
        """Return velocity ``[B, 2]`` and Omega ``[B]``; used where the flow does not set them."""
        return body.velocity, body.angular_velocity

    def compute_wall_speed(self, radius: float, frequency: float) -> float:
        """Return the largest surface speed, nodes per step, of a body of ``radius`` nodes.

        ``frequency`` is in oscillations per step.
        """
        return 0.0

    def compute_bend_rate(self, body: BodyState) -> Tensor:
        """Return the change per step of a fish's bend, ``[B]``; see ``Bending``."""
        return torch.zeros_like(body.bend)

    def compute_command_speed(self, body: BodyState) -> Tensor:
        """Return the speed of the tail ``[B]``, L per step, when a command turns it fastest."""
        return self.compute_bend_rate(body).abs()


class Fixed(Motion):
    """A body that does not move.

    Args:
        kick_speed: largest transverse (y) speed of its surface during the kick, nodes per step; it
            breaks the symmetry of a young wake. At most 0.3.
        kick_steps: length of the kick, one period of a sine, from reset on.
    """

    is_still: ClassVar[bool] = True

    kick_speed: Annotated[float, Field(ge=-MAX_IMPOSED_SPEED, le=MAX_IMPOSED_SPEED)] = 0.0
    kick_steps: PositiveInt = 1

    def prescribe(self, body: BodyState) -> tuple[Tensor, Tensor]:
        """Return zero, apart from the initial kick."""
        swing = self.kick_speed * torch.sin(2.0 * pi * body.age / self.kick_steps)
        kick = torch.where(body.age < self.kick_steps, swing, torch.zeros_like(swing))
        zero = torch.zeros_like(kick)
        return torch.stack((zero, kick), -1), zero


class Driven(Motion):
    """A body that moves at a constant velocity and turns at a constant rate.

    Its surface moves at no more than 0.3 nodes per step.

    Args:
        velocity: (x, y) of the centre of mass, nodes per step.
        angular_velocity: radians per step, counter-clockwise.
    """

    velocity: tuple[float, float] = (0.0, 0.0)
    angular_velocity: Annotated[float, Field(ge=-MAX_IMPOSED_SPEED, le=MAX_IMPOSED_SPEED)] = 0.0

    def __post_init__(self) -> None:
        if hypot(*self.velocity) > MAX_IMPOSED_SPEED:
            raise ValueError(
                f"velocity = {self.velocity}: its norm must be at most {MAX_IMPOSED_SPEED}"
            )

    def prescribe(self, body: BodyState) -> tuple[Tensor, Tensor]:
        """Return the given velocities; the body's state does not matter."""
        zero = torch.zeros_like(body.angular_velocity)
        x, y = self.velocity
        return torch.stack((zero + x, zero + y), -1), zero + self.angular_velocity

    def compute_wall_speed(self, radius: float, frequency: float) -> float:
        """Return the sum of both."""
        return hypot(*self.velocity) + abs(self.angular_velocity) * radius


class Oscillating(Motion):
    """A body that sways and pitches: x0 + sway sin(phase), heading0 + pitch sin(phase + lag).

    It starts at phase 0, so the heading that it is given is heading0 + pitch sin(lag). The phase
    rises with the ``frequency`` given to the solver, which is 0 by default.

    Args:
        sway: amplitude (x, y) in nodes.
        pitch: amplitude in radians.
        pitch_lag: phase of the pitch ahead of the sway, radians.
        pivot: distance of the pitch axis, whose position is x0, ahead of the centre of mass,
            nodes.
    """

    sway: tuple[float, float] = (0.0, 0.0)
    pitch: float = 0.0
    pitch_lag: float = 0.0
    pivot: float = 0.0

    def prescribe(self, body: BodyState) -> tuple[Tensor, Tensor]:
        """Return the velocities that move the body exactly along its path in one step."""
        after = body.phase + 2.0 * pi * body.frequency
        swing = torch.sin(after) - torch.sin(body.phase)
        turn = torch.sin(after + self.pitch_lag) - torch.sin(body.phase + self.pitch_lag)
        turn = self.pitch * turn
        heading = body.heading + turn
        x = self.sway[0] * swing - self.pivot * (torch.cos(heading) - torch.cos(body.heading))
        y = self.sway[1] * swing - self.pivot * (torch.sin(heading) - torch.sin(body.heading))
        return torch.stack((x, y), -1), turn

    def compute_wall_speed(self, radius: float, frequency: float) -> float:
        """Return the sum of the largest speeds of sway and pitch."""
        reach = hypot(*self.sway) + abs(self.pitch) * (radius + abs(self.pivot))
        return 2.0 * pi * abs(frequency) * reach


class Surging(Oscillating):
    """A body that sways along y and pitches as prescribed, and that the flow moves along x.

    The x component of ``sway`` has no effect.
    """

    free_axes: ClassVar[tuple[int, ...]] = (0,)


class Free(Motion):
    """A body that the flow moves and turns."""

    free_axes: ClassVar[tuple[int, ...]] = (0, 1, 2)


class Commanded(Motion):
    """A fish that the flow moves and the command turns; the torque this requires is reported."""

    free_axes: ClassVar[tuple[int, ...]] = (0, 1)

    def prescribe(self, body: BodyState) -> tuple[Tensor, Tensor]:
        """Return the commanded turn rate."""
        return body.velocity, compute_turn_rate(body)

    def compute_command_speed(self, body: BodyState) -> Tensor:
        """Return it for the middle of the turn, which is twice as fast as on average."""
        return body.turn.abs() / body.turn_steps


class Towed(Commanded):
    """A commanded fish that keeps its initial velocity along x; the flow moves it along y alone."""

    free_axes: ClassVar[tuple[int, ...]] = (1,)
    holds_x: ClassVar[bool] = True


class Bending(Motion):
    """A free fish that turns by bending its midline; no external torque.

    The bend adds L kappa x^2 to the midline, x in body lengths from the head. During a command
    kappa relaxes towards -gain * turn, afterwards back to zero: the tail moves to the side of the
    turn and stays there while commands continue.

    Args:
        gain: bend per radian of commanded turn. With 1, successive commands of 15 degrees turn a
            Carling swimmer at Re = 7000 and L = 50 by 11 degrees per tail beat, with 0.5 by 8;
            larger values only slow it.
        response: time constants of the relaxation in the length of a command. Large ones
            move the tail fast, at up to ``response`` times the change of kappa L per command.
    """

    free_axes: ClassVar[tuple[int, ...]] = (0, 1, 2)

    gain: float = 1.0
    response: Annotated[float, Field(gt=0, le=MAX_RESPONSE)] = MAX_RESPONSE

    def compute_bend_rate(self, body: BodyState) -> Tensor:
        """Return the relaxation towards the command."""
        is_commanded = body.turn_clock < body.turn_steps
        goal = torch.where(is_commanded, -self.gain * body.turn, torch.zeros_like(body.turn))
        return (goal - body.bend) * self.response / body.turn_steps.clamp_min(MAX_RESPONSE)
