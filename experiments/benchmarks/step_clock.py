"""Time the parts of a step: ``PYTHONPATH=<checkout> python step_clock.py preset=gait_bend``.

It runs by its path, so that it can time the package of an older commit as well. It prints the facts
of the flow, and answers each line with a number n by the least seconds of the parts in n steps.
"""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import pi
from time import perf_counter
from typing import Any

import torch

from fishrl.physics import InPlaceSolver
from fishrl.programs.train_settings import TRAINING

#: Column of each part, by the beginning of its name, and steps of a burst of the whole.
COLUMNS = {"collision": "collision", "reflection": "exchange", "coupling": "exchange"}
COLUMNS |= dict.fromkeys(("skin", "moved skin", "contact", "moved contact"), "skin")
COLUMNS |= {"uncovering": "uncovering", "edges": "edges", "crossing": "edges"}
COLUMNS |= dict.fromkeys(("filling", "restriction", "shift choice"), "interface")
BURST = 20


def start(words: Sequence[str]) -> tuple[InPlaceSolver, float]:
    """Return one compiled flow of a training, its bodies apart, and its tail-beat period."""
    task: Any = TRAINING.read(words).task
    config, period = task.flow_config(), task.scales.period
    solver = InPlaceSolver(config=config, num_envs=1, frequency=1.0 / period, num_workers=0)
    at_x = torch.linspace(0.6, 0.2, max(2, len(config.bodies)), dtype=torch.float64)
    places = torch.stack((at_x * config.width, 0.0 * at_x + 0.5 * config.height), -1)
    num_bodies = len(config.bodies)
    solver.reset_(
        torch.ones(1, dtype=torch.bool), places[None, :num_bodies], torch.full((1, num_bodies), pi)
    )
    solver.compile()
    solver.advance_(200)
    return solver, period


Steps = list[list[tuple[str, list[Callable[[], object]]]]]


def list_calls(solver: InPlaceSolver) -> Steps:
    """Return the calls of each part, by column, in an even and an odd step."""

    def bind(part: Any, arguments: Any) -> list[Callable[[], object]]:
        if not hasattr(part, "record"):  # older commits
            return [partial(part.run, *arguments)]
        calls: list[Callable[[], object]] = part.record(arguments)
        return calls

    def find_column(name: str) -> str:
        return next(column for start, column in COLUMNS.items() if name.startswith(start))

    parts = solver.list_calls()
    return [[(find_column(part.name), bind(part, own[k])) for part, own in parts] for k in (0, 1)]


def time_parts(solver: InPlaceSolver, num_steps: int) -> Iterator[dict[str, float]]:
    """Yield the seconds of the parts of pairs of steps, and of steps without clocks between."""
    steps, rows = list_calls(solver), torch.ones(1, dtype=torch.bool)
    for _ in range(num_steps // BURST):
        yield {column: 0.5 * spent for column, spent in time_pair(steps).items()}
        before = perf_counter()
        solver.advance_(BURST, rows)  # as environments do
        yield {"seconds": (perf_counter() - before) / BURST}


def time_pair(steps: Steps) -> dict[str, float]:
    """Return the seconds of the parts of a pair of steps, by column."""
    spent: dict[str, float] = {}
    before = perf_counter()
    for step in steps:
        for column, calls in step:
            for call in calls:
                call()
            now = perf_counter()
            spent[column] = spent.get(column, 0.0) + now - before
            before = now
    return spent


def main() -> None:
    """Answer requests until the input ends."""
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)  # as a step does, of which parts are called here
    solver, period = start(sys.argv[1:])
    state, config = solver.state_dict(), solver.config
    facts = {"width": config.width, "height": config.height, "period": period}
    print(json.dumps(facts), flush=True)
    for line in sys.stdin:
        solver.load_state_dict(state)
        solver.advance_(2)  # which finds where the bodies are
        least: dict[str, float] = {}
        for spent in time_parts(solver, int(line)):
            least |= {name: min(value, least.get(name, value)) for name, value in spent.items()}
        print(json.dumps(least), flush=True)


if __name__ == "__main__":
    main()
