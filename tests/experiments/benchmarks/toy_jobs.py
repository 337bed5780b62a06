"""Jobs of the benchmark that take no time, or fail on purpose."""

import os
import threading
from collections.abc import Sequence
from pathlib import Path

from experiments.benchmarks.comparison import WALLS, BenchmarkSettings, Case


def make_pair(settings: BenchmarkSettings) -> Sequence[Case]:
    """Make two cases; the first writes a line per burst into a file of the environment."""

    def advance(num_steps: int) -> dict[str, float]:
        with Path(os.environ["TOY_LOG"]).open("a", encoding="utf-8") as lines:
            lines.write(f"{os.getpid()} {num_steps}\n")
        return {"share": 0.25}

    return [
        Case(label="pair/a", name="a", advance=advance, num_steps=2, num_nodes=1000,
              working_set=36_000, scope=WALLS, facts={"slip": 0.1}),
        Case(label="pair/b", name="b", num_steps=1, num_nodes=10),
    ]  # fmt: skip


def make_number(settings: BenchmarkSettings) -> Sequence[Case]:
    return [Case(label="compile/warm", name="kept", num_steps=0, facts={"seconds": 0.5})]


def miss_a_package(settings: BenchmarkSettings) -> Sequence[Case]:
    raise ImportError("No module named 'peer'")


def fail_at_once(settings: BenchmarkSettings) -> Sequence[Case]:
    raise RuntimeError("the shear wave decays otherwise")


def fail_in_a_burst(settings: BenchmarkSettings) -> Sequence[Case]:
    def advance(num_steps: int) -> None:
        raise ZeroDivisionError("by nothing")

    return [Case(label="late/a", name="a", advance=advance, num_steps=1)]


def die_between_bursts(settings: BenchmarkSettings) -> Sequence[Case]:
    threading.Timer(0.5, os._exit, (4,)).start()
    return [Case(label=f"rest/{i}", name=i, num_steps=1) for i in "ab"]
