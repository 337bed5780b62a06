"""Validation cases whose runs take no time, or go wrong on purpose."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Results


def square(*, value: float, diary: str) -> Result:
    with Path(diary).open("a", encoding="utf-8") as lines:
        lines.write(f"{value:g}\n")
    return {"square": value * value}


def blow_up() -> Result:
    raise RuntimeError("the flow diverged")


def die() -> Result:
    os._exit(3)


def return_a_path() -> Result:
    return {"path": Path()}


def square_nothing() -> Result:
    return {}


def stop_parent(*, number: int, diary: str) -> Result:
    """Signal the process that runs the cases once the runs before are written down."""
    done = Path(diary).parent / "results"
    while len(list(done.rglob("*.json"))) < 2:
        time.sleep(0.02)
    os.kill(os.getppid(), signal.Signals(number))
    time.sleep(600.0)
    return {}


def make_squares(
    *,
    diary: Path,
    values: Sequence[float] = (2.0, 3.0),
    reference: float = 9.0,
    note: str = "",
    others: Sequence[tuple[Callable[..., Result], dict[str, Any]]] = (),
) -> Case:
    """Return a case that judges the square of the last value; quick is the first value alone."""

    def make_jobs(quick: bool) -> list[Job]:
        squares = [
            Job(f"x = {v:g}", square, {"value": v, "diary": str(diary)}, cost=10.0 * v)
            for v in (values[:1] if quick else values)
        ]
        return squares + [Job(f.__name__, f, arguments) for f, arguments in others]

    def judge(results: Results) -> list[Check]:
        squares = {name: r["square"] for name, r in results.items() if "square" in r}
        last = list(squares)[-1]
        return [
            Check(
                quantity="square of the last",
                ours=squares[last],
                reference=reference,
                source="arithmetic",
                tolerance=0.01,
                resolution=last,
                refinement=squares,
                note=note,
            ),
            Check(quantity="square of the first", ours=next(iter(squares.values()))),
        ]

    def draw(results: Results) -> Figure:
        figure = Figure(figsize=(2.0, 2.0))
        figure.subplots().plot([r.get("square", 0.0) for r in results.values()])
        return figure

    text = "Squares.\n\nNumbers are multiplied\nby themselves.\n"
    return Case("squares", text, "arithmetic", make_jobs, judge, draw)
