"""What every code must do before it is timed: damp a shear wave at the viscosity it was given.

u_x = U sin(k y) decays as exp(-nu k^2 t) in a periodic box, whatever U.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log, pi

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.floating]


class ShearWave:
    """A shear wave of about 50 nodes in a periodic box, and its decay.

    Args:
        width: nodes along x.
        height: nodes along y.
        tau: relaxation time.
        speed: U, nodes per step.
        num_steps: that the decay is measured over, even.
        tolerance: largest relative error of the viscosity; that of the lattice itself grows as k^2
            and stays below 1 % at this wave length.
    """

    def __init__(
        self,
        width: int,
        height: int,
        *,
        tau: float = 0.6,
        speed: float = 0.02,
        num_steps: int = 100,
        tolerance: float = 0.03,
    ) -> None:
        self.width, self.height, self.tau, self.speed = width, height, tau, speed
        self.num_steps, self.tolerance = num_steps, tolerance
        self._k = 2.0 * pi * max(1, round(height / 50)) / height
        self._shape = np.sin(self._k * np.arange(height))

    @property
    def nu(self) -> float:
        """Kinematic viscosity, (tau - 1/2) / 3."""
        return (self.tau - 0.5) / 3.0

    def velocity(self) -> Field:
        """Return u_x ``[Y, X]`` at start."""
        return np.repeat(self.speed * self._shape[:, None], self.width, 1)

    def measure_error(self, advance: Callable[[int], object], read: Callable[[], Field]) -> float:
        """Return by what share the viscosity of a flow is too large.

        Args:
            advance: run so many steps, from the wave of ``velocity`` on.
            read: return u_x ``[Y, X]``.
        """
        advance(20)  # equilibrium populations carry no stress yet
        before = self._measure(read())
        advance(self.num_steps)
        after = self._measure(read())
        if not after > 0.0:
            return float("inf")
        return log(before / after) / (self._k**2 * self.num_steps * self.nu) - 1.0

    def check(self, advance: Callable[[int], object], read: Callable[[], Field]) -> float:
        """Measure, and refuse what is not this flow.

        Returns:
            The relative error of the viscosity.

        Raises:
            RuntimeError: if the wave decays otherwise.
        """
        error = self.measure_error(advance, read)
        if not abs(error) <= self.tolerance:
            raise RuntimeError(
                f"it damps a shear wave as if the viscosity were {100 * error:+.1f} % off; "
                f"allowed is {100 * self.tolerance:.0f} %: its time means nothing"
            )
        return error

    def _measure(self, velocity: Field) -> float:
        return float(2.0 * (self._shape[:, None] * velocity).mean() / self.speed)
