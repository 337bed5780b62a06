"""Time a step of the presets at an earlier commit and now, in turns, on one core.

    python studies/performance_history/steps.py e28df4c1 docs/performance.md

Each flow has a process per version. They take turns in rounds of 200 steps from the same start, of
which the fastest burst of 20 steps counts, and of each part the fastest pair of steps. The table
replaces what is between the marks ``before: begin`` and ``before: end`` of the page.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from math import pi
from pathlib import Path
from time import perf_counter
from typing import Any

ROOT = Path(__file__).parents[2]
#: Name of each case, and its settings in both versions.
CASES = {
    "gait_bend": ("preset=gait_bend", "preset=gait_bend"),
    "gait_small": ("preset=gait_small", "preset=gait_small"),
    "L = 50": ("preset=small", "task.body_length=50 task.levels=1"),
    "paper": ("preset=paper", "preset=paper"),
}
ROUNDS, NUM_STEPS, BURST = 20, 200, 20
#: Column of each part, by the beginning of its name.
COLUMNS = {"collision": "collision", "reflection": "bodies", "coupling": "bodies"}
COLUMNS |= dict.fromkeys(("skin", "moved skin", "contact", "moved contact"), "bodies")
COLUMNS |= {"uncovering": "bodies", "edges": "edges", "crossing": "edges"}


def time_flow(words: Sequence[str]) -> None:
    """Answer each line of the input by the least seconds of the parts of a step, and of a step."""
    import torch

    from fishrl.physics import InPlaceSolver
    from fishrl.programs.train_settings import TRAINING

    torch.set_num_threads(1)
    torch.set_flush_denormal(True)  # as a step does, of which parts are called here
    task: Any = TRAINING.read(words).task
    config, num, every = task.flow_config(), len(task.flow_config().bodies), torch.tensor([True])
    frequency = 1.0 / task.scales.period
    solver = InPlaceSolver(config=config, num_envs=1, frequency=frequency, num_workers=0)
    at_x = torch.linspace(0.6, 0.2, max(2, num), dtype=torch.float64)[:num]  # apart
    places = torch.stack((at_x * config.width, 0.0 * at_x + 0.5 * config.height), -1)
    solver.reset_(every, places[None], torch.full((1, num), pi))
    solver.compile()
    solver.advance_(NUM_STEPS)
    start = solver.state_dict()

    def bind(part: Any, arguments: Any) -> list[Callable[[], object]]:
        is_old = not hasattr(part, "record")
        return [partial(part.run, *arguments)] if is_old else part.record(arguments)

    for _ in sys.stdin:
        solver.load_state_dict(start)
        solver.advance_(2)  # which finds where the bodies are
        parts = [
            (find_column(part.name), [bind(part, own[k]) for k in (0, 1)])
            for part, own in solver.list_calls()
        ]
        least: dict[str, float] = {}
        for _ in range(NUM_STEPS // BURST):
            spent: dict[str, float] = {}
            for parity in (0, 1):
                before = perf_counter()
                for column, calls in parts:
                    for call in calls[parity]:
                        call()
                    now = perf_counter()
                    spent[column] = spent.get(column, 0.0) + 0.5 * (now - before)
                    before = now
            before = perf_counter()
            solver.advance_(BURST, every)  # as environments do
            spent["step"] = (perf_counter() - before) / BURST
            least = {name: min(time, least.get(name, time)) for name, time in spent.items()}
        print(json.dumps(least), flush=True)


def find_column(part: str) -> str:
    """Return the column of a part."""
    return next(column for start, column in COLUMNS.items() if part.startswith(start))


def start_clock(folder: Path, words: str) -> subprocess.Popen[str]:
    """Start the process of a flow, with the package of a folder."""
    return subprocess.Popen(
        [sys.executable, __file__, *words.split()],
        env=os.environ | {"PYTHONPATH": str(folder.resolve()), "OMP_NUM_THREADS": "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def ask(clock: Any) -> dict[str, float]:
    """Return the least seconds of a round."""
    print(file=clock.stdin, flush=True)
    times: dict[str, float] = json.loads(clock.stdout.readline())
    return times


def compare(before: Path) -> str:
    """Return the table of all cases."""
    lines = [
        "| case | step before, µs | step, µs | / before | bodies before, µs | bodies, µs | / before"
        " | collision, µs | step / collision |",
        "|" + "---|" * 9,
    ]
    for name, words in CASES.items():
        clocks = [
            start_clock(folder, own) for folder, own in zip((before, ROOT), words, strict=True)
        ]
        rounds = [[ask(clock) for clock in clocks] for _ in range(ROUNDS)]
        old, new = ({k: min(r[i][k] for r in rounds) for k in rounds[0][i]} for i in (0, 1))
        for clock in clocks:
            clock.communicate()
        cells = [name]
        for part in ("step", "bodies"):
            cells += [f"{1e6 * t[part]:.0f}" for t in (old, new)] + [f"{new[part] / old[part]:.2f}"]
        cells += [f"{1e6 * new['collision']:.0f}", f"{new['step'] / new['collision']:.2f}"]
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return "\n".join(lines)


def write_page(commit: str, page: Path) -> None:
    """Replace the table of a page by one that compares with a commit."""
    from experiments.benchmarks.machine import describe_machine

    machine = describe_machine()
    revision = subprocess.check_output(["git", "rev-parse", "--short=8", "HEAD"], text=True).strip()
    heading = (
        f"{machine['cpu']}, one core, load at start {machine['load']}; torch {machine['torch']}; "
        f"commits {commit} and {revision}."
    )
    with tempfile.TemporaryDirectory() as before:
        files = subprocess.check_output(["git", "archive", commit, "fishrl"])
        subprocess.run(["tar", "x", "-C", before], input=files, check=True)
        table = f"{heading}\n\n{compare(Path(before))}"
    begin, end = "<!-- before: begin -->", "<!-- before: end -->"
    first, _, rest = page.read_text(encoding="utf-8").partition(begin)
    last = rest.partition(end)[2]
    page.write_text(f"{first}{begin}\n{table}\n{end}{last}", encoding="utf-8")


if __name__ == "__main__":
    if "=" in sys.argv[1]:
        time_flow(sys.argv[1:])
    else:
        sys.path.insert(0, str(ROOT))
        write_page(sys.argv[1], Path(sys.argv[2]))
