"""Teams of the benchmark that take no time, or go wrong on purpose."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

from experiments.benchmarks.entry import WALLS, Entry, Settings, Team


def make_walker(*, name: str, diary: str) -> list[Entry]:
    def advance(num_steps: int) -> dict[str, float]:
        with Path(diary).open("a", encoding="utf-8") as lines:
            lines.write(f"{name} {num_steps}\n")
        return {"share": 0.25}

    return [
        Entry(label=f"{name}/a", name="a walk", advance=advance, num_steps=2, num_nodes=1000,
              working_set=36_000, scope=WALLS, facts={"slip": 0.1}),
        Entry(label=f"{name}/b", name="a nap", advance=lambda n: None, num_steps=1),
    ]  # fmt: skip


def miss_a_package() -> list[Entry]:
    raise ImportError("No module named 'peer'")


def fail_at_once() -> list[Entry]:
    raise RuntimeError("it damps a shear wave wrongly")


def fail_later() -> list[Entry]:
    def advance(num_steps: int) -> None:
        raise ZeroDivisionError("by nothing")

    return [Entry(label="late/a", name="a trap", advance=advance, num_steps=1)]


def die_at_rest() -> list[Entry]:
    """Answer one burst, and be gone before the next is asked for."""

    def advance(num_steps: int) -> None:
        threading.Timer(0.005, os._exit, (4,)).start()

    return [Entry(label=f"rest/{i}", name="a rest", advance=advance, num_steps=1) for i in "ab"]


def die() -> list[Entry]:
    os._exit(3)


def make_team(make: Callable[..., list[Entry]], code: str, **arguments: str) -> Team:
    return Team(code=code, group="toys", make=make, arguments=dict(arguments))


def list_walkers(settings: Settings) -> list[Team]:
    """Return a team for the command line; it writes into the folder of the environment."""
    return [make_team(make_walker, "fishrl", name="walker", diary=os.environ["TOY_DIARY"])]


def list_failures(settings: Settings) -> list[Team]:
    return [make_team(fail_at_once, "fishrl")]


def halve(*, number: int) -> int:
    if number % 2:
        raise ValueError(f"{number} is odd")
    return number // 2
