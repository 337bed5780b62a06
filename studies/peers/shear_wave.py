"""The check that every code passes before it is timed: a shear wave decays at its viscosity.

u_x = U sin(k y) decays as exp(-nu k^2 t) in a periodic box for every U.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import log, nan, pi

import numpy as np
from numpy.typing import NDArray

from experiments.benchmarks.measuring import BenchmarkSettings

Field = NDArray[np.floating]
SPEED = 0.02  # U, nodes per step
TOLERANCE = 0.03  # of the viscosity; the lattice's own error at 50 nodes a wave is below 0.01


@dataclass(frozen=True)
class ShearWave:
    """A shear wave of about 50 nodes in a periodic box."""

    width: int
    height: int
    num_steps: int = 100  # that the decay is measured over, even
    tau: float = 0.6  # relaxation time

    @property
    def wavenumber(self) -> float:
        """k, radians per node."""
        return 2.0 * pi * max(1, round(self.height / 50)) / self.height

    def velocity(self) -> Field:
        """Return u_x ``[Y, X]`` at start."""
        shape = np.sin(self.wavenumber * np.arange(self.height))
        return np.repeat(SPEED * shape[:, None], self.width, 1)

    def check(self, advance: Callable[[int], object], read: Callable[[], Field]) -> None:
        """Check the viscosity of a flow that has started from the wave and whose u_x is read."""
        start, nu = self.velocity(), (self.tau - 0.5) / 3.0
        advance(20)  # equilibrium populations carry no stress yet
        before = float((start * read()).mean())
        advance(self.num_steps)
        ratio = float((start * read()).mean()) / before
        decay = -log(ratio) if ratio > 0.0 else nan
        error = decay / (nu * self.wavenumber**2 * self.num_steps) - 1.0
        if not abs(error) <= TOLERANCE:
            raise RuntimeError(
                f"the shear wave decays as if the viscosity were {100 * error:+.1f} % off, allowed "
                f"is {100 * TOLERANCE:.0f} %: another flow, whose speed cannot be compared"
            )


def make_wave(settings: BenchmarkSettings, num_steps: int = 100) -> ShearWave:
    """Return the wave in a box of the large case's size."""
    return ShearWave(10 * settings.body_length, 5 * settings.body_length, num_steps)
