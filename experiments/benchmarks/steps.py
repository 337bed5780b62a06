"""Benchmarks of what people train on: the step of each preset by its parts, decisions, tasks.

One flow on one core. With ``before``, the folder of another commit, its step takes turns with ours:

    mkdir before && git archive e28df4c1 fishrl | tar x -C before
    python -m experiments.benchmark 'groups=[steps]' before=before
"""

import json
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from experiments.benchmarks.environment import FLOWS, make_overhead
from experiments.benchmarks.measuring import Benchmark, BenchmarkSettings
from fishrl.benchmark import find_version, list_versions
from fishrl.envs import Flows, make_env, make_task
from fishrl.presets import REPLACED
from fishrl.programs.train_settings import TRAINING

ROOT = Path(__file__).parents[2]
#: Steps of a burst.
NUM_STEPS = 200
#: Names of presets that only earlier versions have.
NAMES = {"small": "L = 50"}


class Clock:
    """A process that times the parts of a step, with the package of a folder."""

    def __init__(self, words: Sequence[str], folder: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, Path(__file__).with_name("step_clock.py"), *words],
            env=os.environ | {"PYTHONPATH": str(folder.resolve()), "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.facts = self._read()

    def time(self, num_steps: int) -> dict[str, float]:
        """Return the least seconds of each part, and of a step, in a burst."""
        assert self._process.stdin is not None
        print(num_steps, file=self._process.stdin, flush=True)
        return self._read()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        read: dict[str, Any] = json.loads(self._process.stdout.readline())
        return read


def list_words(preset: str) -> list[str]:
    """Return the settings of a preset, also of one that only earlier versions have."""
    return REPLACED.get(preset, f"preset={preset}").split()


def make_steps(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return benchmarks of the presets' steps, here and in the folder of an earlier commit."""
    folders = {"now": ROOT}
    if settings.before is not None:
        folders = {"before": Path(settings.before), **folders}
    cases = []
    for preset in settings.presets:
        for when, folder in folders.items():
            words = list_words(preset) if when == "now" else [f"preset={preset}"]
            clock, name = Clock(words, folder), NAMES.get(preset, preset)
            case = Benchmark(
                label=f"{preset}/{when}",
                name=f"{name}, {clock.facts['width']} × {clock.facts['height']}",
                scope=when,
                advance=clock.time,
                num_steps=NUM_STEPS,
                facts=clock.facts,
            )
            cases.append(case)
    return cases


def make_decisions(settings: BenchmarkSettings) -> list[Benchmark]:
    """Return benchmarks of a decision in all flows of each preset, in worker processes."""
    cases = []
    for preset in settings.presets:
        task: Any = TRAINING.read(list_words(preset)).task
        _, case = make_overhead(settings, task=task, flows=FLOWS)
        case.label = f"decision/{preset}"
        case.name = f"{NAMES.get(preset, preset)}, {FLOWS.num_envs} flows"
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
