"""The check that every code passes before it is timed: a shear wave decays at its viscosity.

u_x = U sin(k y) decays as exp(-nu k^2 t) in a periodic box, whatever U.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import log, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.benchmarks.comparison import KERNEL, PERIODIC, BenchmarkSettings, Case

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
                f"is {100 * TOLERANCE:.0f} %: another flow, whose speed cannot be compared"
            )
        return error

    def _measure(self, velocity: Field) -> float:
        return float(2.0 * (self._shape[:, None] * velocity).mean() / SPEED)


def make_wave(settings: BenchmarkSettings, num_steps: int = 100) -> ShearWave:
    """Return the wave in a box of the large case's size."""
    return ShearWave(10 * settings.body_length, 5 * settings.body_length, num_steps)


def make_peer_cases(
    flow: Any, wave: ShearWave, label: str, how: str, *, has_kernel: bool = False
) -> list[Case]:
    """Check a flow that has started from the wave, and return its step and, before it, its kernel.

    Args:
        flow: offers ``advance(num_steps)``, ``velocity()`` ``[Y, X]`` along x and ``num_bytes``.
        wave: from which it has started.
        label: of the step.
        how: in words.
        has_kernel: whether ``advance(num_steps, has_halo=False)`` runs the kernel alone.
    """
    error = wave.check(flow.advance, flow.velocity)
    scopes = {PERIODIC: (label, flow.advance)}
    if has_kernel:
        kernel = partial(flow.advance, has_halo=False)
        scopes = {KERNEL: (f"{label}, kernel", kernel)} | scopes
    return [
        Case(
            label=case, name=f"1 × {wave.width} × {wave.height}, {how}", scope=scope,
            advance=advance, num_nodes=wave.width * wave.height, working_set=flow.num_bytes,
            multiple=2, facts={"viscosity_error": error},
        )
        for scope, (case, advance) in scopes.items()
    ]  # fmt: skip
