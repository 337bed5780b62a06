"""lettuce's own time step in torch, eager and compiled: BGK, its fastest collision, and rolls."""

from __future__ import annotations

import torch

from experiments.benchmarks.comparison import BenchmarkSettings, Case
from experiments.benchmarks.peers.shear_wave import Field, ShearWave, make_peer_cases, make_wave


class LettuceFlow:
    """A periodic flow of lettuce that starts from a wave."""

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
        self.num_bytes = 2 * self._flow.f.nbytes
        self._step = self._run
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


def make_cases(settings: BenchmarkSettings) -> list[Case]:
    """Make the step, eager and compiled."""
    cases, wave = [], make_wave(settings, num_steps=20)
    for name in ("eager", "compiled"):
        flow = LettuceFlow(wave, is_compiled=name == "compiled")
        cases += make_peer_cases(flow, wave, f"lettuce/{name}", f"{name}, {settings.cores}")
    return cases
