"""Compare fishrl's step with lbmpy, numba, lettuce and XLB, each a periodic flow.

    python studies/peers/peers.py threads=1 body_length=100

Those that are not installed are skipped and listed. lbmpy and numba run this project's collision
with its rates and precision; lettuce and XLB run BGK, their fastest.
"""

import itertools
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch

from experiments.benchmarks.flows import make_case, make_kernel_case, make_solver
from experiments.benchmarks.measuring import (
    KERNEL,
    PERIODIC,
    Benchmark,
    BenchmarkSettings,
    measure,
    repeat,
)
from fishrl.physics.cases import PERIODIC as PERIODIC_EDGES
from fishrl.physics.collision import Rates
from fishrl.physics.lattice import CX, W
from fishrl.programs.program import program
from numba_kernel import make_kernels
from shear_wave import Field, ShearWave, make_wave


class Peer(NamedTuple):
    """A flow that starts from a shear wave; ``kernel`` runs steps without edges."""

    advance: Callable[[int], object]
    velocity: Callable[[], Field]  # u_x [Y, X]
    num_bytes: int
    kernel: Callable[[int], object] | None = None


def make_flow_case(label: str, shape: tuple[int, int, int], how: str, **given: Any) -> Benchmark:
    """Return the benchmark of a step of flows of a shape."""
    num_flows, width, height = shape
    name = f"{num_flows} × {width} × {height}, {how}"
    return Benchmark(label=label, name=name, num_nodes=num_flows * width * height, **given)


def make_cases(peer: Peer, wave: ShearWave, label: str, how: str) -> list[Benchmark]:
    """Check a flow that has started from the wave; return its kernel, if known, and its step."""
    wave.check(peer.advance, peer.velocity)
    shape, size = (1, wave.width, wave.height), {"working_set": peer.num_bytes}
    step = make_flow_case(label, shape, how, scope=PERIODIC, advance=peer.advance, **size)
    if peer.kernel is None:
        return [step]
    name = f"{label}, kernel"
    return [make_flow_case(name, shape, how, scope=KERNEL, advance=peer.kernel, **size), step]


def make_lbmpy(settings: BenchmarkSettings) -> list[Benchmark]:
    """Make every pattern for one large flow, and the fastest for a batch of half its size."""
    wave, cases, num_flows = make_wave(settings), [], 16
    for pattern, words in (
        ("pull", "two buffers"),
        ("aa", "in place (AA)"),
        ("esotwist", "in place (esoteric twist)"),
    ):
        peer = make_lbmpy_flow(wave, pattern, settings.threads)
        how = f"{words}, {settings.cores}"
        cases += make_cases(peer, wave, f"lbmpy/{pattern}", how)
    small = ShearWave(wave.width // 2, wave.height // 2)
    batch = make_lbmpy_flow(small, "esotwist", settings.threads, num_copies=num_flows)
    shape, size = (num_flows, small.width, small.height), num_flows * batch.num_bytes
    case = make_flow_case(f"lbmpy/batch{num_flows}", shape, how, scope=KERNEL, working_set=size)
    case.advance = batch.kernel
    return [*cases, case]


def make_lbmpy_flow(wave: ShearWave, pattern: str, threads: int, *, num_copies: int = 0) -> Peer:
    """Return a flow of lbmpy's generated kernels, with its own exchange of the periodic halo.

    With ``num_copies`` the kernels advance so many copies of it in turn; in place only.
    """
    import pystencils as ps
    from lbmpy import LBMConfig, LBMOptimisation, LBStencil, Method, Stencil, create_lb_update_rule
    from lbmpy.advanced_streaming import LBMPeriodicityHandling, Timestep
    from lbmpy.macroscopic_value_kernels import macroscopic_values_getter, macroscopic_values_setter

    is_in_place = pattern != "pull"
    data = ps.create_data_handling(
        (wave.width, wave.height), periodicity=True, default_layout="fzyx", default_ghost_layers=1
    )
    arrays = data.cpu_arrays

    def add(name: str, num_values: int) -> Any:
        return data.add_array(name, values_per_cell=num_values, dtype=np.float32, alignment=64)

    stencil, names = LBStencil(Stencil.D2Q9), ("f",) if is_in_place else ("f", "g")
    fields, velocity = [add(name, 9) for name in names], add("u", 2)
    steps = (Timestep.EVEN, Timestep.ODD) if is_in_place else (Timestep.BOTH,)
    rates, config = Rates(), make_kernel_config(has_threads=threads > 1)
    rules = [
        create_lb_update_rule(
            lbm_config=LBMConfig(
                stencil=stencil,
                method=Method.MRT,
                weighted=False,
                # of the stresses, of e, of the energy fluxes, of eps
                relaxation_rates=[1.0 / wave.tau, rates.energy, rates.flux, rates.energy],
                compressible=True,
                zero_centered=True,
                streaming_pattern=pattern,
                timestep=step,
            ),
            lbm_optimisation=LBMOptimisation(
                symbolic_field=fields[0], symbolic_temporary_field=fields[-1], field_layout="fzyx"
            ),
        )
        for step in steps
    ]
    kernels = [ps.create_kernel(rule, config).compile() for rule in rules]
    wrap = LBMPeriodicityHandling(stencil, data, "f", streaming_pattern=pattern)

    def make_io(make: Any, rho: float | None) -> Any:
        rule = make(
            rules[-1].method, rho, velocity.center_vector, pdfs=fields[0],
            streaming_pattern=pattern, previous_timestep=steps[-1],
        )  # fmt: skip
        return ps.create_kernel(rule, ps.CreateKernelConfig(default_dtype="float32")).compile()

    get = make_io(macroscopic_values_getter, None)
    for name in (*names, "u"):
        data.fill(name, 0.0, ghost_layers=True)
    arrays["u"][1:-1, 1:-1, 0] = wave.velocity().T
    data.run_kernel(make_io(macroscopic_values_setter, 1.0))

    def read() -> Field:
        data.run_kernel(get)
        return np.array(arrays["u"][1:-1, 1:-1, 0].T)

    def advance(num_steps: int, *, has_halo: bool = True) -> None:
        for _ in range(num_steps // len(steps)):
            for before, kernel in zip(steps[-1:] + steps, kernels, strict=False):
                if has_halo:
                    wrap(before)
                data.run_kernel(kernel)
                if not is_in_place:
                    data.swap("f", "g")

    def advance_copies(num_steps: int) -> None:
        for populations in copies:
            repeat(*(partial(kernel, f=populations) for kernel in kernels))(num_steps)

    for i in range(num_copies):
        add(f"f{i}", 9)
        arrays[f"f{i}"][...] = arrays["f"]
    copies = [arrays[f"f{i}"] for i in range(num_copies)]
    num_bytes = int(sum(arrays[name].nbytes for name in names))
    kernel = advance_copies if copies else partial(advance, has_halo=False)
    return Peer(advance, read, num_bytes, kernel)


def make_kernel_config(*, has_threads: bool) -> Any:
    """Return how lbmpy compiles: single precision, vector instructions where known."""
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


def make_numba(settings: BenchmarkSettings) -> list[Benchmark]:
    """Make the pulling collision in two buffers of padded rows: the kernel and the whole step."""
    import numba

    numba.set_num_threads(settings.threads)
    wave = make_wave(settings)
    width, height, u = wave.width, wave.height, wave.velocity()
    pitch = -(-(width + 2) // 16) * 16
    buffers = [*np.zeros((2, 9, height + 2, pitch), dtype=np.float32)]
    inside = np.s_[:, 1:-1, 1 : width + 1]
    pull, wrap = make_kernels(width, height, pitch, 1.0 / wave.tau)
    for q, f in enumerate(buffers[0][inside]):
        cu = CX[q] * u
        f[:] = W[q] * (3.0 * cu + 4.5 * cu * cu - 1.5 * u * u)

    def read() -> Field:
        f = buffers[0][inside].astype(np.float64)
        velocity: Field = np.tensordot(CX, f, 1) / (1.0 + f.sum(0))
        return velocity

    def advance(num_steps: int, *, has_halo: bool = True) -> None:
        for _ in range(num_steps):
            if has_halo:
                wrap(buffers[0].reshape(-1))
            pull(buffers[0].reshape(-1), buffers[1].reshape(-1))
            buffers.reverse()

    peer = Peer(advance, read, 2 * buffers[0].nbytes, partial(advance, has_halo=False))
    return make_cases(peer, wave, "numba/step", f"two buffers, {settings.cores}")


def make_lettuce(settings: BenchmarkSettings) -> list[Benchmark]:
    """Make lettuce's own time step in torch, eager and compiled."""
    wave, cases = make_wave(settings, num_steps=20), []
    for name in ("eager", "compiled"):
        peer = make_lettuce_flow(wave, is_compiled=name == "compiled")
        cases += make_cases(peer, wave, f"lettuce/{name}", f"{name}, {settings.cores}")
    return cases


def make_lettuce_flow(wave: ShearWave, *, is_compiled: bool) -> Peer:
    """Return a flow of lettuce."""
    import lettuce

    context = lettuce.Context(device=torch.device("cpu"), use_native=False)
    size = [wave.width, wave.height]
    flow = lettuce.TaylorGreenVortex(context, size, 100.0, 0.05, lettuce.D2Q9())
    simulation = lettuce.Simulation(flow, lettuce.BGKCollision(wave.tau), [])
    u = torch.zeros(2, wave.width, wave.height)
    u[0] = torch.as_tensor(wave.velocity()).T
    flow.f = flow.equilibrium(flow, rho=torch.ones_like(u[:1]), u=u)

    def step() -> None:
        simulation._collide_and_stream(simulation)

    if is_compiled:
        torch._dynamo.config.recompile_limit = 64
        step = torch.compile(step)
    advance = torch.no_grad()(repeat(step))
    return Peer(advance, lambda: flow.u()[0].T.double().numpy(), 2 * flow.f.nbytes)


def make_xlb(settings: BenchmarkSettings) -> list[Benchmark]:
    """Make XLB's own time step by its Warp backend, which runs on one core of a CPU."""
    import warp
    import xlb
    from xlb.grid import grid_factory
    from xlb.operator.macroscopic import Macroscopic
    from xlb.operator.stepper import IncompressibleNavierStokesStepper

    wave = make_wave(settings, num_steps=20)
    warp.config.quiet = True
    policy, backend = xlb.PrecisionPolicy.FP32FP32, xlb.ComputeBackend.WARP
    velocity_set = xlb.velocity_set.D2Q9(precision_policy=policy, compute_backend=backend)
    xlb.init(velocity_set=velocity_set, default_backend=backend, default_precision_policy=policy)
    grid = grid_factory((wave.width, wave.height), compute_backend=backend)
    stepper: Any = IncompressibleNavierStokesStepper(grid=grid, boundary_conditions=[])
    fields: list[Any] = list(stepper.prepare_fields())
    macroscopic = Macroscopic(velocity_set, policy, backend)
    rho, u = (grid.create_field(cardinality=n, dtype=policy.compute_precision) for n in (1, 2))
    start = np.zeros((2, wave.width, wave.height, 1), dtype=np.float32)
    start[0, :, :, 0] = wave.velocity().T
    u.assign(start)
    rho.fill_(1.0)
    stepper.equilibrium(rho, u, fields[0])
    count = itertools.count()

    def step() -> None:
        f, g = stepper(*fields, 1.0 / wave.tau, next(count))
        fields[:2] = g, f

    def read() -> Field:
        macroscopic(fields[0], rho, u)
        return np.asarray(u.numpy()[0, :, :, 0].T, dtype=np.float64)

    peer = Peer(repeat(step), read, 2 * int(fields[0].capacity))
    return make_cases(peer, wave, "xlb/warp", "Warp, one core")


def make_ours(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return the pass over all nodes, a step with walls, and one with a fish of the default skin."""
    size, cores = settings.body_length, settings.cores
    periodic = make_solver(size, has_fish=False, boundaries=PERIODIC_EDGES)
    walls, fish = (make_solver(size, has_fish=has_fish) for has_fish in (False, True))
    return [
        make_kernel_case(periodic, "fishrl/kernel", cores),
        make_case(walls, "fishrl/walls", cores),
        make_case(fish, "fishrl/fish", cores),
    ]


@program()
def main(settings: BenchmarkSettings) -> None:
    """Measure all codes in turn; print speeds, and the ratios of fishrl's of the same rounds."""
    torch.set_num_threads(settings.threads)
    ours, others = make_ours(settings), []
    for make in (make_lbmpy, make_numba, make_lettuce, make_xlb):
        try:
            others += make(settings)
        except ImportError as error:
            print(f"skipped: {error}")
    measure([*ours, *others], settings)
    print("| case | what | MLUPS | " + " | ".join(f"{own.label} / it" for own in ours) + " |")
    for case in [*ours, *others]:
        speeds = find_speeds(case)
        cells = [show(speeds, 0), *(show(find_speeds(own) / speeds, 2) for own in ours)]
        print(f"| {case.label}, {case.name} | {case.scope} | {' | '.join(cells)} |")


def find_speeds(case: Benchmark) -> Any:
    """Return million node updates per second, by round."""
    return case.num_nodes / np.array(case.measured["seconds"]) / 1e6


def show(values: Any, digits: int) -> str:
    """Return median and quartiles."""
    low, middle, high = np.percentile(values, (25, 50, 75))
    return f"{middle:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


if __name__ == "__main__":
    main()
