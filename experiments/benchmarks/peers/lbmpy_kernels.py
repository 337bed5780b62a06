"""lbmpy's generated kernels: two buffers, and in place by the AA pattern or the esoteric twist.

Same lattice, collision, rates, precision and threads; the kernels alone, and whole steps with
lbmpy's own exchange of the periodic halo.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from experiments.benchmarks.comparison import KERNEL, BenchmarkSettings, Case
from experiments.benchmarks.peers.shear_wave import Field, ShearWave, make_peer_cases, make_wave
from fishrl.physics.collision import Rates

PATTERNS = {
    "pull": "two buffers",
    "aa": "in place (AA)",
    "esotwist": "in place (esoteric twist)",
}


class LbmpyFlow:
    """A periodic flow of lbmpy that starts from a wave.

    Args:
        wave: size, relaxation time and initial velocity.
        pattern: how populations move in memory, of ``PATTERNS``.
        threads: cores that the kernels use.
    """

    def __init__(self, wave: ShearWave, pattern: str, threads: int) -> None:
        import pystencils as ps
        from lbmpy import LBStencil, Stencil
        from lbmpy.advanced_streaming import LBMPeriodicityHandling, Timestep
        from lbmpy.macroscopic_value_kernels import (
            macroscopic_values_getter,
            macroscopic_values_setter,
        )

        self._is_in_place = pattern != "pull"
        self._data = ps.create_data_handling(
            (wave.width, wave.height), periodicity=True, default_layout="fzyx",
            default_ghost_layers=1,
        )  # fmt: skip
        stencil, names = LBStencil(Stencil.D2Q9), ("f",) if self._is_in_place else ("f", "g")
        fields, velocity = [self._add(name, 9) for name in names], self._add("u", 2)
        self.num_bytes = int(sum(self._data.cpu_arrays[name].nbytes for name in names))
        self._steps = (Timestep.EVEN, Timestep.ODD) if self._is_in_place else (Timestep.BOTH,)
        config = make_kernel_config(has_threads=threads > 1)
        rules = [make_rule(fields, stencil, wave.tau, pattern, step) for step in self._steps]
        self._kernels = [ps.create_kernel(rule, config).compile() for rule in rules]
        self._wrap = LBMPeriodicityHandling(stencil, self._data, "f", streaming_pattern=pattern)

        def make_io(make: Any, rho: float | None) -> Any:
            rule = make(
                rules[-1].method, rho, velocity.center_vector, pdfs=fields[0],
                streaming_pattern=pattern, previous_timestep=self._steps[-1],
            )  # fmt: skip
            config = ps.CreateKernelConfig(default_dtype="float32")
            return ps.create_kernel(rule, config).compile()

        self._get = make_io(macroscopic_values_getter, None)
        for name in (*names, "u"):
            self._data.fill(name, 0.0, ghost_layers=True)
        self._data.cpu_arrays["u"][1:-1, 1:-1, 0] = wave.velocity().T
        self._data.run_kernel(make_io(macroscopic_values_setter, 1.0))

    def _add(self, name: str, num_values: int) -> Any:
        return self._data.add_array(
            name, values_per_cell=num_values, dtype=np.float32, alignment=64
        )

    def velocity(self) -> Field:
        """Return the velocity ``[Y, X]`` along x."""
        self._data.run_kernel(self._get)
        return np.array(self._data.cpu_arrays["u"][1:-1, 1:-1, 0].T)

    def advance(self, num_steps: int, *, has_halo: bool = True) -> None:
        """Advance by an even number of steps, or run the kernels alone."""
        for _ in range(num_steps // len(self._steps)):
            for before, kernel in zip(self._steps[-1:] + self._steps, self._kernels, strict=False):
                if has_halo:
                    self._wrap(before)
                self._data.run_kernel(kernel)
                if not self._is_in_place:
                    self._data.swap("f", "g")

    def make_batch(self, num_flows: int) -> Callable[[int], None]:
        """Return the kernels on copies of this flow, one after the other; in place only."""
        arrays = []
        for i in range(num_flows):
            self._add(f"f{i}", 9)
            arrays.append(self._data.cpu_arrays[f"f{i}"])
            arrays[-1][...] = self._data.cpu_arrays["f"]

        def advance(num_steps: int) -> None:
            for array in arrays:
                for _ in range(num_steps // len(self._steps)):
                    for kernel in self._kernels:
                        kernel(f=array)

        return advance


def make_kernel_config(*, has_threads: bool) -> Any:
    """Return how kernels are compiled: single precision, vector instructions where known."""
    import pystencils as ps

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without py-cpuinfo the C++ compiler vectorises alone
        targets = ps.Target.available_vector_cpu_targets()
    config = ps.CreateKernelConfig(target=ps.Target.CurrentCPU if targets else ps.Target.GenericCPU)
    config.default_dtype = "float32"
    config.cpu.openmp.enable = has_threads
    if targets:
        config.cpu.vectorize.enable = True
        config.cpu.vectorize.assume_inner_stride_one = True
    return config


def make_rule(fields: Sequence[Any], stencil: Any, tau: float, pattern: str, step: Any) -> Any:
    """Return lbmpy's assignments of one step with this project's relaxation rates."""
    from lbmpy import LBMConfig, LBMOptimisation, Method, create_lb_update_rule

    rates = Rates()
    return create_lb_update_rule(
        lbm_config=LBMConfig(
            stencil=stencil,
            method=Method.MRT,
            weighted=False,
            # of the stresses, of e, of the energy fluxes, of eps
            relaxation_rates=[1.0 / tau, rates.energy, rates.flux, rates.energy],
            compressible=True,
            zero_centered=True,
            streaming_pattern=pattern,
            timestep=step,
        ),
        lbm_optimisation=LBMOptimisation(
            symbolic_field=fields[0], symbolic_temporary_field=fields[-1], field_layout="fzyx"
        ),
    )


def make_cases(settings: BenchmarkSettings, *, num_flows: int = 16) -> list[Case]:
    """Make every pattern for one large flow, and the fastest for a batch of half its size."""
    wave, cases = make_wave(settings), []
    for pattern, words in PATTERNS.items():
        flow, how = LbmpyFlow(wave, pattern, settings.threads), f"{words}, {settings.cores}"
        cases += make_peer_cases(flow, wave, f"lbmpy/{pattern}", how, has_kernel=True)
    small = ShearWave(wave.width // 2, wave.height // 2)
    flow = LbmpyFlow(small, "esotwist", settings.threads)
    batch = Case(
        label=f"lbmpy/batch{num_flows}",
        name=f"{num_flows} × {small.width} × {small.height}, {how}",
        scope=KERNEL,
        advance=flow.make_batch(num_flows),
        num_nodes=num_flows * small.width * small.height,
        working_set=num_flows * flow.num_bytes,
        multiple=2,
    )
    return [*cases, batch]
