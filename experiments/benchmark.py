"""How fast the flow is: ``python -m experiments.benchmark`` (``make bench``).

Cases take turns in short bursts, so that a machine that changes its mind does so for all of them;
medians and quartiles over the rounds are printed and written as JSON. MLUPS are million lattice
node updates per second; the ceiling of a single-precision step that reads and writes each
population once is the copy bandwidth divided by 72 bytes.
"""

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from math import pi
from pathlib import Path
from typing import Any

import torch

from fishrl.physics import FlowConfig, InPlaceSolver, Scales
from fishrl.physics.cases import make_swimmer_config

BYTES_PER_NODE = 72
Case = tuple[str, int, Callable[[], object]]


def make_copy(num_nodes: int) -> Case:
    """Copy nine populations of ``num_nodes``: 36 bytes read and 36 written per node."""
    source = torch.rand(9 * num_nodes)
    target = torch.empty_like(source)
    return "copy at 72 B per node (ceiling)", num_nodes, lambda: target.copy_(source)


def make_flow(
    name: str,
    config: FlowConfig,
    *,
    num_envs: int = 1,
    period: int,
    num_steps: int,
    num_workers: int | None = None,
) -> Case:
    """Advance ``num_envs`` flows, the fish swimming in the middle of each."""
    solver = InPlaceSolver(
        config=config, num_envs=num_envs, frequency=1.0 / period, num_workers=num_workers
    )
    rows = torch.ones(num_envs, dtype=torch.bool)
    centre = torch.tensor([[0.5 * config.width, 0.5 * config.height]]).expand(num_envs, 2)
    solver.reset_(rows, centre, torch.full((num_envs,), pi))
    solver.compile()
    num_nodes = num_steps * num_envs * config.width * config.height
    return name, num_nodes, lambda: solver.advance_(num_steps)


def make_cases(body_length: int) -> list[Case]:
    """Make the cases of one body length L: tank 10 L x 5 L, Reynolds number 7000."""
    scales = Scales.from_budget(body_length=body_length, reynolds=7000.0)
    config = make_swimmer_config(scales)
    size = f"{config.width}x{config.height}"
    empty = make_swimmer_config(scales, bodies=())
    half = Scales.from_budget(body_length=body_length // 2, reynolds=3500.0)
    small = make_swimmer_config(half)
    period, threads = scales.period, torch.get_num_threads()
    one = {"period": period, "num_steps": 20}
    return [
        make_copy(config.width * config.height),
        make_flow(f"1 x {size}, flow and walls, {threads} threads", empty, num_workers=0, **one),
        make_flow(f"1 x {size}, swimming fish, {threads} threads", config, num_workers=0, **one),
        make_flow(f"1 x {size}, swimming fish, one core", config, num_workers=1, **one),
        make_flow(
            f"16 x {small.width}x{small.height}, fish in each, core each",
            small,
            num_envs=16,
            period=half.period,
            num_steps=10,
        ),
    ]


def measure(cases: list[Case], rounds: int) -> list[dict[str, Any]]:
    """Run the cases in turn and return a row of MLUPS for each."""
    speeds: list[list[float]] = [[] for _ in cases]
    for number in range(rounds + 1):
        for (_, num_nodes, run), seen in zip(cases, speeds, strict=True):
            start = time.perf_counter()
            run()
            seconds = time.perf_counter() - start
            if number:  # the first round warms up
                seen.append(num_nodes / seconds / 1e6)
    rows: list[dict[str, Any]] = []
    for (name, _, _), seen in zip(cases, speeds, strict=True):
        low, median, high = statistics.quantiles(seen, n=4)
        ratio = statistics.median(a / b for a, b in zip(seen, speeds[0], strict=True))
        rows.append({"case": name, "mlups": median, "quartiles": [low, high], "of_copy": ratio})
    return rows


def describe_machine() -> dict[str, object]:
    """Name what the figures were measured on."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = lines[0].split(":", 1)[1].strip() if lines else model
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "python": platform.python_version(),
    }


def main() -> None:
    """Measure, print a table, write JSON."""
    parser = argparse.ArgumentParser(description="Measure the speed of the flow step.")
    parser.add_argument("--rounds", type=int, default=15, help="bursts per case (default 15)")
    parser.add_argument("--body-length", type=int, default=100, help="L in nodes (default 100)")
    parser.add_argument("--save", type=Path, default=Path("runs/benchmark.json"))
    options = parser.parse_args()
    if options.rounds < 2:
        parser.error(f"--rounds {options.rounds}: quartiles need at least 2")
    machine = describe_machine()
    print(", ".join(f"{key} {value}" for key, value in machine.items()))
    print("compiling ...", flush=True)
    rows = measure(make_cases(options.body_length), options.rounds)
    print(f"{'case':42} {'MLUPS':>7} {'quartiles':>15} {'/ copy':>7}")
    for row in rows:
        low, high = row["quartiles"]
        print(f"{row['case']:42} {row['mlups']:7.0f} {low:7.0f}-{high:7.0f} {row['of_copy']:7.2f}")
    options.save.parent.mkdir(parents=True, exist_ok=True)
    options.save.write_text(json.dumps({"machine": machine, "rows": rows}, indent=2) + "\n")
    print(f"written to {options.save}")


if __name__ == "__main__":
    main()
