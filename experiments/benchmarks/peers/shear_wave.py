"""The check that every code passes before it is timed: a shear wave decays at its viscosity.

u_x = U sin(k y) decays as exp(-nu k^2 t) in a periodic box, whatever U.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log, pi
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from experiments.benchmarks.contest import KERNEL, PERIODIC, Entry, Settings

Field = NDArray[np.floating]
SPEED = 0.02  # U, nodes per step
TOLERANCE = 0.03  # of the viscosity; the lattice's own error at 50 nodes a wave is below 0.01


class ShearWave:
    """A shear wave of about 50 nodes in a periodic box.

    Args:
        width: nodes along x.
        height: nodes along y.
        num_steps: that the decay is measured over, even.
    """

    tau = 0.6  # relaxation time

    def __init__(self, width: int, height: int, num_steps: int = 100) -> None:
        self.width, self.height, self.num_steps = width, height, num_steps
        self._k = 2.0 * pi * max(1, round(height / 50)) / height
        self._shape = np.sin(self._k * np.arange(height))

    def velocity(self) -> Field:
        """Return u_x ``[Y, X]`` at start."""
        return np.repeat(SPEED * self._shape[:, None], self.width, 1)

    def check(self, advance: Callable[[int], object], read: Callable[[], Field]) -> float:
        """Return the relative error of a flow's viscosity.

        Args:
            advance: run so many steps, from the wave of ``velocity`` on.
            read: return u_x ``[Y, X]``.

        Raises:
            RuntimeError: if it is larger than the tolerance.
        """
        advance(20)  # equilibrium populations carry no stress yet
        before = self._measure(read())
        advance(self.num_steps)
        after, error = self._measure(read()), float("inf")
        if after > 0.0:
            nu = (self.tau - 0.5) / 3.0
            error = log(before / after) / (self._k**2 * self.num_steps * nu) - 1.0
        if not abs(error) <= TOLERANCE:
            raise RuntimeError(
                f"the shear wave decays as if the viscosity were {100 * error:+.1f} % off, allowed "
                f"is {100 * TOLERANCE:.0f} %: the flow is another, so its time means nothing"
            )
        return error

    def _measure(self, velocity: Field) -> float:
        return float(2.0 * (self._shape[:, None] * velocity).mean() / SPEED)


class PeerFlow(Protocol):
    """A periodic flow of another code."""

    num_bytes: int  # of the populations

    def advance(self, num_steps: int) -> None:
        """Advance by whole steps."""

    def velocity(self) -> Field:
        """Return the velocity ``[Y, X]`` along x."""


def make_wave(settings: Settings, num_steps: int = 100) -> ShearWave:
    """Return the wave in a box of the large case's size."""
    return ShearWave(10 * settings.body_length, 5 * settings.body_length, num_steps)


def make_peer_entries(
    flow: PeerFlow,
    wave: ShearWave,
    label: str,
    how: str,
    advance_kernel: Callable[[int], None] | None = None,
) -> list[Entry]:
    """Check a flow that has started from the wave, and return its step, and its kernel if given."""
    error = wave.check(flow.advance, flow.velocity)
    cases = {f"{label}, kernel": (KERNEL, advance_kernel), label: (PERIODIC, flow.advance)}
    return [
        Entry(
            label=case, name=f"1 × {wave.width} × {wave.height}, {how}", scope=scope,
            advance=advance, num_nodes=wave.width * wave.height, working_set=flow.num_bytes,
            multiple=2, facts={"viscosity_error": error},
        )
        for case, (scope, advance) in cases.items()
        if advance is not None
    ]  # fmt: skip
