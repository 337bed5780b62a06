"""Benchmarks of flows by size, batch and device; of memory and compilation."""

import gc
import multiprocessing
import os
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from math import pi
from typing import Any

import torch

from experiments.benchmarks import measuring
from experiments.benchmarks.accuracy import read_errors
from experiments.benchmarks.measuring import Benchmark, BenchmarkSettings, repeat
from experiments.benchmarks.step_clock import clock_parts, list_steps
from fishrl.physics import Boundaries, InPlaceSolver, Scales
from fishrl.physics.cases import PERIODIC, make_swimmer_config


def make_solver(
    body_length: int,
    *,
    has_fish: bool,
    boundaries: Boundaries | None = None,
    levels: int = 1,
    **options: Any,
) -> InPlaceSolver:
    """Return compiled flows in the paper's tank, 10 L x 5 L, with a swimming fish in each or none.

    It has walls unless ``boundaries`` are given. Re = 70 L, so that the relaxation time is one;
    ``options`` are those of ``InPlaceSolver``.
    """
    reynolds, unit = 70.0 * body_length, 2**levels
    scales = Scales.from_budget(body_length=body_length, reynolds=reynolds, multiple=unit)
    changes: Any = {} if has_fish else {"bodies": ()}
    if levels > 1:
        size = {"width": 10 * body_length + 1, "height": 5 * body_length + 1}
        changes |= {"levels": levels, **size}
    if boundaries:
        changes["boundaries"] = boundaries
    config = make_swimmer_config(scales, **changes)
    options = {"num_envs": 1, "num_workers": 0} | options
    solver = InPlaceSolver(config=config, frequency=1.0 / scales.period, **options)
    rows = torch.ones(solver.num_envs, dtype=torch.bool, device=solver.device)
    solver.reset_(rows, None, torch.full((solver.num_envs,), pi) if has_fish else None)
    solver.compile()
    return solver


def make_case(
    solver: InPlaceSolver, label: str, how: str, *, num_flows: int | None = None
) -> Benchmark:
    """Return the benchmark of a step of the first ``num_flows`` flows, by default of all."""
    config, num_flows = solver.config, num_flows or solver.num_envs
    is_first = torch.arange(solver.num_envs) < num_flows
    return Benchmark(
        label=label,
        name=f"{num_flows} × {config.width} × {config.height}, {how}",
        num_nodes=num_flows * config.width * config.height,
        scope=measuring.FISH if config.bodies else measuring.WALLS,
        advance=partial(solver.advance_, rows=None if is_first.all() else is_first),
        facts={"flows": num_flows, "body_length": config.width // 10},
    )


def make_kernel_case(solver: InPlaceSolver, label: str, how: str) -> Benchmark:
    """Return the benchmark of the collision alone, in even and odd steps."""
    case, (collide, arguments) = make_case(solver, label, how), solver.list_calls()[0]
    case.scope = measuring.KERNEL
    case.advance = repeat(*(partial(collide.run, *given) for given in arguments))
    return case


def make_copy(label: str, num_nodes: int, device: str = "cpu") -> Benchmark:
    """Return the benchmark of a copy of nine populations, as in a step with two buffers."""
    source = torch.ones(9 * num_nodes, device=device)
    return Benchmark(
        label=label,
        name=f"copy of {source.nbytes / 1e6:.0f} MB",
        scope=measuring.PROBE,
        advance=repeat(partial(torch.empty_like(source).copy_, source)),
        num_nodes=num_nodes,
    )


def make_probes(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return the upper bound of a step in two buffers: a copy of the size of the large flow."""
    return [make_copy("probe/copy", 50 * settings.body_length**2)]


def make_swimmers(settings: BenchmarkSettings, *, has_fish: bool = True) -> list[Benchmark]:
    """Return benchmarks of one flow from L / 4 to 2 L, of one core, and of batches at L / 2."""
    large, what, cases = settings.body_length, "fish" if has_fish else "walls", []
    for size, length, how, batches, num_workers in (
        ("small", large // 4, settings.cores, (1,), 0),
        ("middle", large // 2, settings.cores, (1,), 0),
        ("large", large, settings.cores, (1,), 0),
        ("huge", 2 * large, settings.cores, (1,), 0),
        ("single", large, "one core", (1,), 1),
        ("batch", large // 2, "one core each", (1, 4, 16), min(settings.threads, 16)),
    ):
        before, num_envs = count_tensor_bytes(), max(batches)
        solver = make_solver(length, has_fish=has_fish, num_envs=num_envs, num_workers=num_workers)
        per_node = (count_tensor_bytes() - before) / (50 * length**2 * num_envs)
        for n in batches:
            label = f"{size}{n if size == 'batch' else ''}/{what}"
            cases.append(make_case(solver, label, how, num_flows=n))
            cases[-1].measured["bytes"] = [per_node]
            if has_fish:
                cases[-1].facts["period"] = 1.0 / float(solver.body.frequency[0])
    return cases


#: Body lengths of the levels' benchmarks, over that of the large flow, their levels, and batches.
LEVELS = (
    *((0.32, 1, (1,)), (0.5, 1, (1,)), (0.64, 1, (1,)), (0.64, 2, (1,))),
    *((1.0, 1, (1, 16)), (1.0, 3, (1, 16)), (2.0, 4, (1,))),
)


def make_levels(settings: BenchmarkSettings, **options: Any) -> list[Benchmark]:
    """Return benchmarks of flows that are fine near the fish alone, and of uniform ones.

    All run in this process.
    """
    cases, errors = [], read_errors()
    for scale, levels, batches in LEVELS:
        length = round(scale * settings.body_length)
        for num_envs in batches:
            given = {"num_envs": num_envs, "num_workers": None if num_envs == 1 else 0} | options
            solver = make_solver(length, has_fish=True, levels=levels, **given)
            case = make_case(solver, f"levels/{num_envs}, {length}, {levels}", "")
            case.name = f"L = {length}" + (f", {num_envs} flows" if num_envs > 1 else "")
            case.scope = f"{levels} levels" if levels > 1 else "uniform"
            unit, period = 2**levels, 1.0 / float(solver.body.frequency[0])
            case.advance, case.facts["period"] = partial(advance_pairs, solver, unit), period / unit
            case.facts["updates"] = solver.config.updates_per_step * period
            case.facts["errors"] = errors.get((length, levels), {})
            if num_envs == 1:
                case.prepare = partial(clock_parts, case, solver, list_steps(solver))
            cases.append(case)
    return cases


def advance_pairs(solver: InPlaceSolver, unit: int, num_pairs: int) -> dict[str, float]:
    """Advance by pairs of steps of the coarsest level, each ``unit`` steps of the finest.

    Returns the seconds of processor time of a pair, ``cpu``.
    """
    before = time.process_time()
    solver.advance_(unit * num_pairs)
    return {"cpu": (time.process_time() - before) / num_pairs}


def make_flows(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return benchmarks without bodies: kernel, periodic step, steps with walls."""
    periodic = make_solver(settings.body_length, has_fish=False, boundaries=PERIODIC)
    step = make_case(periodic, "large/periodic", settings.cores)
    step.scope = measuring.PERIODIC
    kernel = make_kernel_case(periodic, "large/kernel", settings.cores)
    return [kernel, step, *make_swimmers(settings, has_fish=False)]


def make_gpu(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return benchmarks of a large batch on a GPU, with and without fish, and of a copy.

    The list is empty without a GPU.
    """
    if not torch.cuda.is_available():
        return []
    make = partial(make_solver, settings.body_length // 2, num_envs=64, device="cuda")
    empty, how = make(has_fish=False), "all in one launch"
    return [
        make_copy("gpu/copy", 64 * empty.config.width * empty.config.height, "cuda"),
        make_kernel_case(empty, "gpu/kernel", how),
        make_case(empty, "gpu/walls", how),
        make_case(make(has_fish=True), "gpu/fish", how),
    ]


def make_compilation(settings: BenchmarkSettings) -> list[Benchmark]:
    """Measure the time to the first step with an empty cache, then with a full one."""
    cases, spawn = [], multiprocessing.get_context("spawn")  # a fork of one with threads may hang
    with tempfile.TemporaryDirectory(prefix="fishrl-compile-") as folder:
        for label, name in (("cold", "empty cache"), ("warm", "full cache")):
            with ProcessPoolExecutor(1, mp_context=spawn) as process:
                job = process.submit(time_compilation, settings.body_length // 2, folder)
                measured = {"seconds": [job.result()]}
                case = Benchmark(
                    label=f"compile/{label}", name=name, num_steps=0, measured=measured
                )
                cases.append(case)
    return cases


def time_compilation(body_length: int, folder: str) -> float:
    """Return the seconds to compile the step with a fish, with its cache in a folder."""
    os.environ["TORCHINDUCTOR_CACHE_DIR"] = folder
    start = time.perf_counter()
    make_solver(body_length, has_fish=True, num_workers=None).advance_(2)  # as people start one
    return time.perf_counter() - start


def count_tensor_bytes() -> int:
    """Return the bytes of all distinct storages of tensors in this process."""
    gc.collect()
    storages = {}
    for thing in gc.get_objects():
        if type(thing) is torch.Tensor:  # not the compiler's fake ones
            storage = thing.untyped_storage()
            storages[storage.data_ptr()] = storage.nbytes()
    return sum(storages.values())
