"""Time the parts of a step: collision, what it does for bodies, edges, interfaces of levels."""

from collections.abc import Callable
from time import perf_counter

from experiments.benchmarks.measuring import Benchmark
from fishrl.physics import InPlaceSolver
from fishrl.torch_state import in_own_state

#: Column of each part, by the beginning of its name.
COLUMNS = dict.fromkeys(("reflection", "coupling", "exchange"), "exchange")
COLUMNS |= {"collision": "collision", "contact": "skin", "uncovering": "uncovering"}
COLUMNS |= dict.fromkeys(("edges", "crossing"), "edges")
COLUMNS |= dict.fromkeys(("filling", "restriction", "shift choice"), "interface")
#: Calls of an even and an odd step of the coarsest level, by column.
Steps = list[list[tuple[str, list[Callable[[], object]]]]]


def list_steps(solver: InPlaceSolver) -> Steps:
    """Return the calls of a pair of steps, without changing the flow."""

    def find_column(name: str) -> str:
        return next(column for start, column in COLUMNS.items() if name.startswith(start))

    before, parts = solver.state_dict(), solver.list_calls()
    steps = [[(find_column(part.name), part.record(own[k])) for part, own in parts] for k in (0, 1)]
    solver.load_state_dict(before)
    return steps


@in_own_state  # as a step does: no denormal numbers
def clock_parts(case: Benchmark, solver: InPlaceSolver, steps: Steps) -> None:
    """Measure the least seconds of each part in a step of the finest level; restores the flow."""
    before, pairs = solver.state_dict(), [time_pair(steps) for _ in range(10)]
    num_steps = 2 * solver.config.coarsest_spacing
    for column in pairs[0]:
        least = min(pair[column] for pair in pairs) / num_steps
        case.measured.setdefault(column, []).append(least)
    solver.load_state_dict(before)


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
