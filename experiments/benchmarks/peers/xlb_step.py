"""XLB's own time step by its Warp backend: BGK, two buffers.

XLB is made for GPUs: Warp runs on one core of a CPU, however many there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.benchmarks.comparison import BenchmarkSettings, Case
from experiments.benchmarks.peers.shear_wave import Field, ShearWave, make_peer_cases, make_wave


class XLBFlow:
    """A periodic flow of XLB that starts from a wave."""

    def __init__(self, wave: ShearWave) -> None:
        import warp
        import xlb
        from xlb.grid import grid_factory
        from xlb.operator.macroscopic import Macroscopic
        from xlb.operator.stepper import IncompressibleNavierStokesStepper

        warp.config.quiet = True
        policy, backend = xlb.PrecisionPolicy.FP32FP32, xlb.ComputeBackend.WARP
        velocity_set = xlb.velocity_set.D2Q9(precision_policy=policy, compute_backend=backend)
        xlb.init(
            velocity_set=velocity_set, default_backend=backend, default_precision_policy=policy
        )
        grid = grid_factory((wave.width, wave.height), compute_backend=backend)
        self._stepper: Any = IncompressibleNavierStokesStepper(grid=grid, boundary_conditions=[])
        self._fields: list[Any] = list(self._stepper.prepare_fields())
        self._macroscopic = Macroscopic(velocity_set, policy, backend)
        self._rho, self._u = (
            grid.create_field(cardinality=n, dtype=policy.compute_precision) for n in (1, 2)
        )
        u = np.zeros((2, wave.width, wave.height, 1), dtype=np.float32)
        u[0, :, :, 0] = wave.velocity().T
        self._u.assign(u)
        self._rho.fill_(1.0)
        self._stepper.equilibrium(self._rho, self._u, self._fields[0])
        self._omega, self._count = 1.0 / wave.tau, 0
        self.num_bytes = 2 * int(self._fields[0].capacity)

    def advance(self, num_steps: int) -> None:
        """Advance by whole steps."""
        for _ in range(num_steps):
            f, g, boundaries, missing = self._fields
            f, g = self._stepper(f, g, boundaries, missing, self._omega, self._count)
            self._fields[:2] = g, f
            self._count += 1

    def velocity(self) -> Field:
        """Return the velocity ``[Y, X]`` along x."""
        self._macroscopic(self._fields[0], self._rho, self._u)
        return np.asarray(self._u.numpy()[0, :, :, 0].T, dtype=np.float64)


def make_cases(settings: BenchmarkSettings) -> list[Case]:
    """Make the step."""
    wave = make_wave(settings, num_steps=20)
    return make_peer_cases(XLBFlow(wave), wave, "xlb/warp", "Warp, one core")
