"""Benchmarks of what people train on: the step of each preset by its parts, decisions, tasks."""

import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from math import pi
from pathlib import Path
from typing import Any

import torch

from experiments.benchmarks.environment import FLOWS, make_overhead
from experiments.benchmarks.measuring import Benchmark, BenchmarkSettings
from experiments.benchmarks.step_clock import clock_parts, list_steps
from fishrl.benchmark import find_version, list_versions
from fishrl.envs import AbstractTask, Flows, make_env, make_task
from fishrl.physics import InPlaceSolver
from fishrl.torch_state import in_own_state, one_thread

#: Steps of a round, and of the bursts of which the fastest counts.
NUM_STEPS, BURST = 192, 32


def start_flow(task: AbstractTask, **options: Any) -> InPlaceSolver:
    """Return one compiled flow of a task after some steps, its bodies apart."""
    config, frequency = task.flow_config(), 1.0 / task.scales.period
    solver = InPlaceSolver(config=config, num_envs=1, frequency=frequency, num_workers=0, **options)
    num = len(config.bodies)
    at_x = torch.linspace(0.6, 0.2, max(2, num), dtype=torch.float64)[:num]
    places = torch.stack((at_x * config.width, 0.0 * at_x + 0.5 * config.height), -1)
    solver.reset_(torch.ones(1, dtype=torch.bool), places[None], torch.full((1, num), pi))
    solver.compile()
    solver.advance_(NUM_STEPS)
    return solver


def make_step(name: str, task: AbstractTask, **options: Any) -> Benchmark:
    """Return the benchmark of the step of one flow, on one core, and of its parts."""
    with one_thread():
        solver = start_flow(task, **options)
        steps, start = list_steps(solver), solver.state_dict()
    config = solver.config

    def prepare() -> None:
        """Return to the start, for the fish swims away, and time the parts."""
        with one_thread():
            solver.load_state_dict(start)
            solver.advance_(2 * config.coarsest_spacing)  # which finds where the bodies are
            clock_parts(case, solver, steps)

    @in_own_state
    def advance(num_steps: int) -> dict[str, float]:
        """Return the seconds of a step in the fastest burst, as environments advance."""
        times, rows = [time.perf_counter()], torch.ones(1, dtype=torch.bool)
        with one_thread():
            for _ in range(num_steps // BURST):
                solver.advance_(BURST, rows)
                times.append(time.perf_counter())
        return {"seconds": min(b - a for a, b in pairwise(times)) / BURST}

    case = Benchmark(
        label=f"steps/{name}",
        name=f"{name}, {config.width} × {config.height}",
        prepare=prepare,
        advance=advance,
        num_steps=NUM_STEPS,
        facts={"period": task.scales.period},
    )
    return case


def make_steps(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return benchmarks of the steps of the presets."""
    return [make_step(preset, make_task(preset)) for preset in settings.presets]


def make_decisions(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return benchmarks of a decision in all flows of each preset, in worker processes."""
    cases = []
    for preset in settings.presets:
        (case,) = make_overhead(settings, task=make_task(preset), flows=FLOWS)
        case.label = f"decision/{preset}"
        case.name = f"{preset}, {FLOWS.num_envs} flows"
        case.facts["flows"] = FLOWS.num_envs
        cases.append(case)
    return cases


def make_tasks(settings: BenchmarkSettings) -> list[Benchmark]:
    """Measure random actions in each task of the benchmark that has its own flows, in a process."""
    cases, spawn = [], multiprocessing.get_context("spawn")
    for name in list_versions():
        if "-quick-" in name or find_version(name).references is not None:
            continue
        with ProcessPoolExecutor(1, mp_context=spawn) as process:
            measured, facts = process.submit(time_task, name).result()
        cases.append(
            Benchmark(label=f"tasks/{name}", name=name, num_steps=0, measured=measured, facts=facts)
        )
    return cases


def time_task(
    name: str, flows: Flows = FLOWS, num_decisions: int = 20
) -> tuple[dict[str, list[float]], dict[str, Any]]:
    """Return seconds of the first decision and of the next ones, memory in bytes, and facts."""
    start = time.perf_counter()
    task = make_task(name)
    env = make_env(task=task, flows=flows, seed=0)
    state, times = env.reset(), []
    for _ in range(1 + num_decisions):
        _, state = env.step_and_maybe_reset(env.rand_action(state))
        times.append(time.perf_counter())
    measured = {
        "first": [times[0] - start],
        "seconds": [(times[-1] - times[0]) / num_decisions],
    }
    if sys.platform == "linux":
        measured["memory"] = [float(sum_memory(os.getpid()))]
    env.close()
    return measured, {"flows": flows.num_envs, "period": 1.0 / task.interval_T}


def sum_memory(process: int) -> int:
    """Return the bytes of a process and its children under Linux; shared ones count once."""
    folder = Path(f"/proc/{process}")
    own = (folder / "smaps_rollup").read_text().split("Pss:")[1].split()[0]
    children = (folder / "task" / str(process) / "children").read_text().split()
    return 1024 * int(own) + sum(sum_memory(int(child)) for child in children)
