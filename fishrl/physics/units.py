"""From Reynolds number, body length and a Mach budget to lattice units.

A preset is a body length and a speed budget; everything else follows. The budget limits the speed
of the tail, 2 pi f L times the largest amplitude a(x), and of the stream, whichever is faster.
nu = L^2 / (Re T), tau = 3 nu + 1/2.
"""

from typing import Annotated

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from fishrl.physics.bodies.gait import CARLING, Gait
from fishrl.settings import Settings, checked

# Validated range. Below MIN_TAU the collision is no longer stable for vortices shed in a turn;
# above MAX_TAU the boundary's slip grows. Walls move well below the speed of sound, 0.577.
MIN_TAU = 0.501
MAX_TAU = 2.0
MAX_WALL_SPEED = 0.15
# Fastest wall in the default presets: Mach 0.12. Vortices shed in a turn reach 2 to 3 times that.
DEFAULT_WALL_SPEED = 0.07


def check_tau(tau: float, *, given: tuple[str, str, str] | None = None) -> None:
    """Raise if ``tau`` lies outside the validated range.

    ``given`` names the settings that it follows from: two to raise for a larger one, one to lower.
    """
    if not MIN_TAU <= tau <= MAX_TAU:
        up, down = ("raise", "lower") if tau < MIN_TAU else ("lower", "raise")
        remedy = f"{up} it; compute_tau gives that of a Reynolds number"
        if given is not None:
            length, speed, reynolds = given
            remedy = f"{up} {length}, {up} {speed} or {down} {reynolds}"
        raise ValueError(
            f"tau = {tau:.5f} lies outside the validated range [{MIN_TAU}, {MAX_TAU}]: {remedy}"
        )


@checked
def compute_tau(*, length: PositiveFloat, speed: PositiveFloat, reynolds: PositiveFloat) -> float:
    """Return the relaxation time of a flow around a body.

    Args:
        length: D or L in nodes.
        speed: U in nodes per step.
        reynolds: U D / nu.

    Raises:
        ValueError: if one is not positive, or the result lies outside the validated range.
    """
    tau = 3.0 * speed * length / reynolds + 0.5
    check_tau(tau, given=("length", "speed", "reynolds"))
    return tau


class Scales(Settings):
    """Lattice units of a swimming fish.

    Args:
        body_length: L in nodes.
        reynolds: Re_f = L^2 / (T nu).
        period: T, steps per tail beat; even.
        gait: sets the tail's speed.
        max_frequency: fastest beat that will be commanded, tail beats per T.
        stream_speed_bl: fastest stream, L / T.
    """

    body_length: Annotated[int, Field(ge=16)]
    reynolds: PositiveFloat
    period: Annotated[int, Field(ge=2)]
    gait: Gait = CARLING
    max_frequency: PositiveFloat = 1.0
    stream_speed_bl: NonNegativeFloat = 0.0

    def __post_init__(self) -> None:
        if self.period % 2:
            raise ValueError(f"period = {self.period}: must be an even number of steps")
        fastest, name = max((self.tail_speed, "tail speed"), (self.stream_speed, "stream speed"))
        if fastest > MAX_WALL_SPEED * (1.0 + 1e-9):  # a budget at its limit may round up
            raise ValueError(
                f"{name} = {fastest:.3f} nodes per step (Mach {fastest * 3**0.5:.2f}) > "
                f"{MAX_WALL_SPEED}: raise period or lower max_wall_speed"
            )
        check_tau(self.tau, given=("body_length", "max_wall_speed", "reynolds"))

    @classmethod
    @checked
    def from_budget(
        cls,
        *,
        body_length: PositiveInt,
        reynolds: PositiveFloat,
        max_wall_speed: PositiveFloat = DEFAULT_WALL_SPEED,
        gait: Gait = CARLING,
        max_frequency: PositiveFloat = 1.0,
        stream_speed_bl: NonNegativeFloat = 0.0,
        multiple: PositiveInt = 2,
    ) -> "Scales":
        """Choose the shortest even period that keeps tail and stream within ``max_wall_speed``.

        ``max_wall_speed`` is in nodes per step; times sqrt(3) it is a Mach number. The period is a
        multiple of an even number, of 2^levels for a flow with levels. The other arguments are as
        for the class.
        """
        if not 0.0 < max_wall_speed <= MAX_WALL_SPEED:
            raise ValueError(
                f"max_wall_speed = {max_wall_speed} (Mach {max_wall_speed * 3**0.5:.2f}): allowed "
                f"is (0, {MAX_WALL_SPEED}]; {DEFAULT_WALL_SPEED} is the validated default"
            )
        fastest_bl = max(gait.tail_speed * max_frequency, stream_speed_bl)
        least = fastest_bl * body_length / max_wall_speed
        period = multiple * max(1, -int(-least // multiple))
        return cls(
            body_length=body_length,
            reynolds=reynolds,
            period=period,
            gait=gait,
            max_frequency=max_frequency,
            stream_speed_bl=stream_speed_bl,
        )

    @property
    def nu(self) -> float:
        """Kinematic viscosity in lattice units."""
        return self.body_length**2 / (self.reynolds * self.period)

    @property
    def tau(self) -> float:
        """Relaxation time."""
        return 3.0 * self.nu + 0.5

    @property
    def reference_speed(self) -> float:
        """L / T in nodes per step."""
        return self.body_length / self.period

    @property
    def tail_speed(self) -> float:
        """Fastest wall, nodes per step."""
        return self.gait.tail_speed * self.max_frequency * self.reference_speed

    @property
    def stream_speed(self) -> float:
        """Fastest stream, nodes per step."""
        return self.stream_speed_bl * self.reference_speed

    @property
    def mach(self) -> float:
        """Mach number of the fastest wall or stream."""
        return max(self.tail_speed, self.stream_speed) * 3**0.5
