"""lbmpy's generated kernels: two buffers, and in place by the AA pattern or the esoteric twist.

Same lattice, collision, rates, precision and threads; the kernels alone, and whole steps with
lbmpy's own exchange of the periodic halo.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.benchmarks.entry import KERNEL, PERIODIC, Entry
from experiments.benchmarks.flows import count_threads
from experiments.benchmarks.shear_wave import Field, ShearWave
from fishrl.physics.collision import Rates

TWO_BUFFERS = "pull"
#: lbmpy's names of how populations move in memory, and ours.
PATTERNS = {
    TWO_BUFFERS: "two buffers",
    "aa": "in place (AA)",
    "esotwist": "in place (esoteric twist)",
}


class Flow:
    """One periodic flow of lbmpy.

    Args:
        width: nodes along x.
        height: nodes along y.
        tau: relaxation time.
        pattern: lbmpy's name of how populations move in memory.
        has_threads: whether the kernels run on several threads.
    """

    def __init__(
        self, width: int, height: int, *, tau: float, pattern: str, has_threads: bool
    ) -> None:
        import pystencils as ps
        from lbmpy import LBStencil, Stencil
        from lbmpy.advanced_streaming import LBMPeriodicityHandling, Timestep

        self._is_in_place = pattern != TWO_BUFFERS
        self._data = ps.create_data_handling(
            (width, height), periodicity=True, default_layout="fzyx", default_ghost_layers=1
        )
        stencil = LBStencil(Stencil.D2Q9)
        self._names = ("f",) if self._is_in_place else ("f", "g")
        fields = [self._add(name, 9) for name in self._names]
        velocity = self._add("u", 2)
        self._steps = (Timestep.EVEN, Timestep.ODD) if self._is_in_place else (Timestep.BOTH,)
        config = make_kernel_config(has_threads)
        self._kernels = []
        for step in self._steps:
            rule = make_rule(fields, stencil=stencil, tau=tau, pattern=pattern, step=step)
            self._kernels.append(ps.create_kernel(rule, config).compile())
        self._set, self._get = (
            make_io(rule.method, fields[0], velocity, pattern, self._steps[-1], is_setter=setter)
            for setter in (True, False)
        )
        self._wrap = LBMPeriodicityHandling(stencil, self._data, "f", streaming_pattern=pattern)

    def _add(self, name: str, num_values: int) -> Any:
        return self._data.add_array(
            name, values_per_cell=num_values, dtype=np.float32, alignment=64
        )

    @property
    def num_bytes(self) -> int:
        """Memory of the populations."""
        return int(sum(self._data.cpu_arrays[name].nbytes for name in self._names))

    def set_velocity(self, u: Field) -> None:
        """Start from the equilibrium of a velocity ``[Y, X]`` along x."""
        for name in (*self._names, "u"):
            self._data.fill(name, 0.0, ghost_layers=True)
        self._data.cpu_arrays["u"][1:-1, 1:-1, 0] = u.T
        self._data.run_kernel(self._set)

    def velocity(self) -> Field:
        """Return the velocity ``[Y, X]`` along x."""
        self._data.run_kernel(self._get)
        return np.array(self._data.cpu_arrays["u"][1:-1, 1:-1, 0].T)

    def advance(self, num_steps: int) -> None:
        """Advance by whole steps, halo included; in place by an even number."""
        for _ in range(num_steps // len(self._steps)):
            for before, kernel in zip(self._steps[-1:] + self._steps, self._kernels, strict=False):
                self._wrap(before)
                self._run(kernel)

    def advance_kernel(self, num_steps: int) -> None:
        """Run the kernels alone; the halo stays as it is."""
        for _ in range(num_steps // len(self._steps)):
            for kernel in self._kernels:
                self._run(kernel)

    def copy(self, num_flows: int) -> list[Any]:
        """Return the populations of so many flows in the state of this one; in place only."""
        arrays = []
        for i in range(num_flows):
            self._add(f"f{i}", 9)
            arrays.append(self._data.cpu_arrays[f"f{i}"])
            arrays[-1][...] = self._data.cpu_arrays["f"]
        return arrays

    def advance_array(self, array: Any, num_steps: int) -> None:
        """Run the kernels on one of the copies."""
        for _ in range(num_steps // len(self._steps)):
            for kernel in self._kernels:
                kernel(f=array)

    def _run(self, kernel: Any) -> None:
        self._data.run_kernel(kernel)
        if not self._is_in_place:
            self._data.swap("f", "g")


def make_kernel_config(has_threads: bool) -> Any:
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


def make_rule(fields: Sequence[Any], *, stencil: Any, tau: float, pattern: str, step: Any) -> Any:
    """Return lbmpy's assignments of one step, with the rates that are ours."""
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


def make_io(method: Any, f: Any, u: Any, pattern: str, before: Any, *, is_setter: bool) -> Any:
    """Return the kernel that sets populations from a velocity, or the one that reads it."""
    import pystencils as ps
    from lbmpy.macroscopic_value_kernels import (
        macroscopic_values_getter,
        macroscopic_values_setter,
    )

    options = {"pdfs": f, "streaming_pattern": pattern, "previous_timestep": before}
    if is_setter:
        rule = macroscopic_values_setter(method, 1.0, u.center_vector, **options)
    else:
        rule = macroscopic_values_getter(method, None, u.center_vector, **options)
    return ps.create_kernel(rule, ps.CreateKernelConfig(default_dtype="float32")).compile()


def make_large(*, width: int, height: int, threads: int) -> list[Entry]:
    """Make every pattern for one flow, checked by a shear wave."""
    wave = ShearWave(width, height)
    entries = []
    for pattern, words in PATTERNS.items():
        flow = Flow(width, height, tau=wave.tau, pattern=pattern, has_threads=threads > 1)
        flow.set_velocity(wave.velocity())
        shared: dict[str, Any] = {
            "name": f"1 × {width} × {height}, {words}, {count_threads(threads)}",
            "num_nodes": width * height,
            "working_set": flow.num_bytes,
            "multiple": 2,
            "facts": {"viscosity_error": wave.check(flow.advance, flow.velocity)},
        }
        entries += [
            Entry(label=f"lbmpy/{pattern}", scope=KERNEL, advance=flow.advance_kernel, **shared),
            Entry(
                label=f"lbmpy/{pattern}, periodic", scope=PERIODIC, advance=flow.advance, **shared
            ),
        ]
    return entries


def make_batch(*, width: int, height: int, threads: int, num_flows: int) -> list[Entry]:
    """Make the fastest pattern for a batch, one flow after the other: as much in cache as ours."""
    pattern = "esotwist"
    flow = Flow(width, height, tau=0.6, pattern=pattern, has_threads=threads > 1)
    flow.set_velocity(np.zeros((height, width)))
    arrays = flow.copy(num_flows)

    def advance(num_steps: int) -> None:
        for array in arrays:
            flow.advance_array(array, num_steps)

    return [
        Entry(
            label=f"lbmpy/batch{num_flows}",
            name=f"{num_flows} × {width} × {height}, {PATTERNS[pattern]}, {count_threads(threads)}",
            scope=KERNEL,
            advance=advance,
            num_nodes=num_flows * width * height,
            working_set=num_flows * flow.num_bytes,
            multiple=2,
        )
    ]


def make_entries(*, width: int, height: int, threads: int, num_flows: int) -> list[Entry]:
    """Make one large flow, and a batch of flows of half its size."""
    batch = make_batch(width=width // 2, height=height // 2, threads=threads, num_flows=num_flows)
    return make_large(width=width, height=height, threads=threads) + batch
