"""lettuce's own time step in torch, eager and compiled: BGK, its fastest collision, and rolls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from experiments.benchmarks.entry import PERIODIC, Entry
from experiments.benchmarks.flows import count_threads
from experiments.benchmarks.shear_wave import Field, ShearWave


class Flow:
    """One periodic flow of lettuce.

    Args:
        wave: that it starts from.
        is_compiled: hand the step to torch.compile.
    """

    def __init__(self, wave: ShearWave, *, is_compiled: bool) -> None:
        import lettuce

        context = lettuce.Context(device=torch.device("cpu"), use_native=False)
        self._flow = lettuce.TaylorGreenVortex(
            context, [wave.width, wave.height], 100.0, 0.05, lettuce.D2Q9()
        )
        self._simulation = lettuce.Simulation(self._flow, lettuce.BGKCollision(wave.tau), [])
        u = torch.zeros(2, wave.width, wave.height)
        u[0] = torch.as_tensor(wave.velocity()).T
        self._flow.f = self._flow.equilibrium(self._flow, rho=torch.ones_like(u[:1]), u=u)
        self._step: Callable[[], Any] = self._run
        if is_compiled:
            torch._dynamo.config.recompile_limit = 64
            self._step = torch.compile(self._run)

    def _run(self) -> None:
        self._simulation._collide_and_stream(self._simulation)

    def advance(self, num_steps: int) -> None:
        """Advance by whole steps."""
        with torch.no_grad():
            for _ in range(num_steps):
                self._step()

    def velocity(self) -> Field:
        """Return the velocity ``[Y, X]`` along x."""
        return self._flow.u()[0].T.double().numpy()

    @property
    def num_bytes(self) -> int:
        """Memory of the populations and of what they become."""
        return 2 * self._flow.f.nbytes


def make_entries(*, width: int, height: int, threads: int) -> list[Entry]:
    """Make the step, eager and compiled, checked by a shear wave."""
    torch.set_num_threads(threads)
    entries = []
    for name in ("eager", "compiled"):
        wave = ShearWave(width, height, num_steps=20)
        flow = Flow(wave, is_compiled=name == "compiled")
        entries.append(
            Entry(
                label=f"lettuce/{name}",
                name=f"1 × {width} × {height}, {name}, {count_threads(threads)}",
                scope=PERIODIC,
                advance=flow.advance,
                num_nodes=width * height,
                working_set=flow.num_bytes,
                facts={"viscosity_error": wave.check(flow.advance, flow.velocity)},
            )
        )
    return entries
