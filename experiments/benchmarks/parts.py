"""The parts of a real step, found by what the stepper calls.

Nothing here knows how many parts there are: every function that the stepper keeps among its
attributes, alone or in a list, is one, under its own name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fishrl.physics import InPlaceSolver
from fishrl.physics.fast.step import Stepper

Function = Callable[..., Any]


def get_stepper(solver: InPlaceSolver) -> Stepper:
    """Return what makes the solver's steps.

    Raises:
        RuntimeError: if the solver keeps none; then this file has to be brought up to date.
    """
    for value in vars(solver).values():
        if isinstance(value, Stepper):
            return value
    raise RuntimeError("the solver keeps no Stepper: bring experiments/benchmarks/parts.py to date")


def replace_parts(solver: InPlaceSolver, wrap: Callable[[str, Function], Function]) -> list[str]:
    """Put ``wrap(name, part)`` into the place of each part of the step.

    Args:
        solver: compiled, and run in this process.
        wrap: returns what shall be called instead of a part.

    Returns:
        The names of the parts, such as "collide".
    """
    stepper = get_stepper(solver)
    names = []
    for attribute, value in list(vars(stepper).items()):
        name = attribute.strip("_").replace("_", " ")
        if callable(value):
            setattr(stepper, attribute, wrap(name, value))
            names.append(name)
        elif isinstance(value, list) and value and all(callable(each) for each in value):
            value[:] = [wrap(name, each) for each in value]
            names.append(name)
    return names


def record_calls(
    solver: InPlaceSolver, part: str, num_steps: int = 2
) -> list[tuple[Function, tuple[Any, ...]]]:
    """Return the calls of one part in some real steps, ready to be made again.

    Args:
        solver: compiled, and run in this process.
        part: its name.
        num_steps: an even number.

    Raises:
        RuntimeError: if there is no such part.
    """
    calls: list[tuple[Function, tuple[Any, ...]]] = []
    originals: list[tuple[Function, Function]] = []

    def wrap(name: str, function: Function) -> Function:
        def recording(*arguments: Any) -> Any:
            if name == part:
                calls.append((function, arguments))
            return function(*arguments)

        originals.append((recording, function))
        return recording

    names = replace_parts(solver, wrap)
    solver.advance_(num_steps)
    back = iter(originals)
    replace_parts(solver, lambda _, function: next(f for r, f in back if r is function))
    if not calls:
        raise RuntimeError(f"the step has no part '{part}'; its parts are: {', '.join(names)}")
    return calls
