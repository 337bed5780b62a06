"""Validation cases whose runs take no time, or go wrong on purpose."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs


def square(*, value: float, log: str) -> Result:
    with Path(log).open("a", encoding="utf-8") as lines:
        lines.write(f"{value:g}\n")
    return {"square": value * value}


def blow_up() -> Result:
    raise RuntimeError("the flow diverged")


def die() -> Result:
    os._exit(3)


def return_a_path() -> Result:
    return {"path": Path()}


def stop_parent(*, number: int, log: str) -> Result:
    """Signal the process that runs the cases once the runs before are written, not only staged."""
    done = Path(log).parent / "results"
    while len(list(done.glob("*/*.json"))) < 2:
        time.sleep(0.02)
    os.kill(os.getppid(), signal.Signals(number))
    time.sleep(600.0)
    return {}


def make_squares(
    *,
    log: Path,
    values: Sequence[float] = (2.0, 3.0),
    reference: float = 9.0,
    note: str = "",
    others: Sequence[tuple[Callable[..., Result], dict[str, Any]]] = (),
) -> Case:
    """Return a case that checks the square of the last value; quick is the first value alone."""
    jobs = [
        Job(square, {"value": v, "log": str(log)}, cost=10.0 * v, is_quick=v == values[0])
        for v in values
    ]

    def judge(runs: Runs) -> Iterator[Check]:
        by_value = runs.read("square", "value", log=str(log))
        squares = {f"x = {v:g}": square for v, square in by_value.items()}
        *_, last = squares
        yield Check(
            "square of the last",
            squares[last],
            reference,
            "arithmetic",
            tolerance=0.01,
            resolution=last,
            refinement=squares,
            note=note,
        )
        yield Check("square of the first", next(iter(squares.values())))

    def draw(figure: Figure, runs: Runs) -> None:
        figure.subplots().plot([run.get("square", 0.0) for _, run in runs.finished])

    text = "Squares.\n\nNumbers are multiplied\nby themselves.\n"
    jobs += [Job(function, arguments) for function, arguments in others]
    return Case("squares", text, "arithmetic", jobs, judge, draw, size=(2.0, 2.0))
