"""XLB's own time step by its Warp backend: BGK, two buffers.

Warp runs on one core of a CPU whatever there is; XLB is made for GPUs, so nothing follows from this
for anything but the machine at hand.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.benchmarks.entry import PERIODIC, Entry
from experiments.benchmarks.shear_wave import Field, ShearWave


class Flow:
    """One periodic flow of XLB.

    Args:
        wave: that it starts from.
    """

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
        self._omega = 1.0 / wave.tau
        self._count = 0

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

    @property
    def num_bytes(self) -> int:
        """Memory of both buffers."""
        return 2 * int(self._fields[0].capacity)


def make_entries(*, width: int, height: int) -> list[Entry]:
    """Make the step, checked by a shear wave."""
    wave = ShearWave(width, height, num_steps=20)
    flow = Flow(wave)
    return [
        Entry(
            label="xlb/warp",
            name=f"1 × {width} × {height}, Warp, one core",
            scope=PERIODIC,
            advance=flow.advance,
            num_nodes=width * height,
            working_set=flow.num_bytes,
            facts={"viscosity_error": wave.check(flow.advance, flow.velocity)},
        )
    ]
