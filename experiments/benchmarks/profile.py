"""Group ``profile``: where the time of one environment step goes.

The parts are those of the real step: the stepper's own functions, found by its attributes, and the
environment's, each with a stopwatch around it. All runs in one process on one core, so that the
parts add up.
"""

from __future__ import annotations

import time
from collections import defaultdict
from typing import Any

import torch

from experiments.benchmarks.alone import run_alone
from experiments.benchmarks.entry import Settings
from experiments.benchmarks.environment import Stage, make_task
from experiments.benchmarks.parts import Function, replace_parts
from fishrl.physics import InPlaceSolver

FLOW, ENV, BRAIN = "flow", "environment", "TorchRL and policy"
CHECK = "check for divergence"
#: What the stepper's parts are called here; one that is not listed goes by its own name.
NAMES = {
    "collide": "collision",
    "set edges": "edges",
    "check": CHECK,
    "locate": "markers and stencils",
    "push": "fluid at the markers, force, motion",
    "absorb": "increments of the populations",
    "act": "bodies: markers, force, motion, spreading",
}
REST = "calls, and what is in no part"


class Stopwatch:
    """Adds up the time spent in some functions, each without those that it calls."""

    def __init__(self) -> None:
        self.seconds: dict[tuple[str, str], float] = defaultdict(float)
        self._inside = 0.0

    def wrap(self, where: str, name: str, function: Function) -> Function:
        """Return ``function`` with its time counted as part ``name`` of ``where``."""

        def timed(*arguments: Any, **keywords: Any) -> Any:
            before, self._inside = self._inside, 0.0
            start = time.perf_counter()
            try:
                return function(*arguments, **keywords)
            finally:
                spent = time.perf_counter() - start
                self.seconds[where, name] += spent - self._inside
                self._inside = before + spent

        return timed


def profile_task(
    task: Any, *, num_envs: int, num_actions: int, compile: bool = True
) -> dict[str, Any]:
    """Step the whole environment of a task, and return the seconds of each part per action.

    Args:
        task: what the fish has to do.
        num_envs: number of flows.
        num_actions: that are timed, after one that is not.
        compile: compile the flow step.
    """
    stage = Stage(task=task, num_envs=num_envs, compile=False)
    solver = InPlaceSolver(
        config=task.flow_config(),
        num_envs=num_envs,
        frequency=1.0 / task.scales.period,
        num_workers=0,
        compile=compile,
    )
    solver.compile()
    stage.base.solver = solver
    stage.prepare()
    watch = Stopwatch()

    def wrap(name: str, part: Function) -> Function:
        words = NAMES.get(name, name)
        return watch.wrap(ENV if words == CHECK else FLOW, words, part)

    parts = replace_parts(solver, wrap)
    for owner, name, where, words in (
        (solver, "advance_", FLOW, REST),
        (solver, "is_diverged", ENV, CHECK),
        (stage.base, "measure", ENV, "sensors and measurement"),
        (stage.base, "_step", ENV, "reward, observation, ends"),
        (stage.env, "step_and_maybe_reset", BRAIN, "TorchRL: transforms, specs, resets"),
        (stage, "policy", BRAIN, "policy"),
    ):
        setattr(owner, name, watch.wrap(where, words, getattr(owner, name)))
    stage.run_policy(1)
    watch.seconds.clear()
    for _ in range(num_actions):
        stage.run_policy(1)
    rows: list[dict[str, Any]] = [
        {"where": where, "part": part, "seconds": seconds / num_actions}
        for (where, part), seconds in watch.seconds.items()
    ]
    order = [FLOW, ENV, BRAIN]
    rows.sort(key=lambda row: (order.index(row["where"]), -row["seconds"]))
    return {
        "rows": rows,
        "parts": parts,
        "num_envs": num_envs,
        "substeps": task.n_substeps,
        "size": f"{solver.config.width} × {solver.config.height}",
    }


def profile_batch(*, body_length: int, num_envs: int, num_actions: int) -> dict[str, Any]:
    """Profile the task of the benchmark on one thread."""
    torch.set_num_threads(1)
    return profile_task(make_task(body_length), num_envs=num_envs, num_actions=num_actions)


def run(settings: Settings) -> dict[str, Any]:
    """Profile a batch of the middle size in a process of its own."""
    length = settings.body_length // 2
    return run_alone(profile_batch, body_length=length, num_envs=4, num_actions=3)
