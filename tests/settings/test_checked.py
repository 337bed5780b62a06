"""Functions that check their arguments as settings do."""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from pydantic import Field, PositiveInt

import fishrl
from fishrl.settings import FieldErrors, checked
from fishrl.settings.base import Arguments, find_schema


class Pair(NamedTuple):
    """Any named tuple."""

    first: int
    second: Callable[..., int] | None = None


@checked
def swim(
    pair: Pair | None,
    *rest: str,
    speed: Annotated[float, Field(gt=0)],
    num: PositiveInt = 1,
    **more: Any,
) -> tuple[Any, ...]:
    """Return what arrives."""
    return pair, rest, speed, num, more


def list_checked() -> Iterator[Any]:
    """List the functions and methods of the package that check their arguments."""
    for module in pkgutil.walk_packages(fishrl.__path__, "fishrl."):
        for owner in [found := importlib.import_module(module.name), *vars(found).values()]:
            if owner is found or (inspect.isclass(owner) and owner.__module__ == module.name):
                for function in vars(owner).values():
                    function = getattr(function, "__func__", function)
                    if getattr(function, "__module__", "") == module.name and is_checked(function):
                        yield pytest.param(function, id=f"{module.name}.{function.__qualname__}")


def is_checked(function: object) -> bool:
    """Return whether ``checked`` has wrapped a function, outermost or below another decorator."""
    while function is not None:
        if getattr(function, "__code__", None) is swim.__code__:
            return True
        function = getattr(function, "__wrapped__", None)
    return False


def test_arguments_arrive_as_given_and_numbers_of_numpy_as_python_s() -> None:
    pair = Pair(1)
    given = swim(pair, "a", speed=np.float32(0.5), num=np.int64(3), other=np.int64(4))
    assert given == (pair, ("a",), 0.5, 3, {"other": 4}) and given[0] is pair
    assert [type(value) for value in given[2:4]] == [float, int]


def test_every_wrong_argument_has_its_line() -> None:
    with pytest.raises(FieldErrors) as caught:
        swim((1, None), speed=float("nan"), num=0)  # type: ignore[arg-type]
    assert [line.split(":")[0] for line in str(caught.value).splitlines()] == [
        "pair = (1, None)",
        "speed = nan",
        "num = 0",
    ]
    with pytest.raises(TypeError, match="missing a required argument: 'speed'"):
        swim(None)  # type: ignore[call-arg]


@pytest.mark.parametrize("function", list(list_checked()))
def test_public_functions_refuse_an_argument_of_no_kind_by_its_name(function: Any) -> None:
    schema = find_schema(inspect.unwrap(function), without=("self", "cls"), bases=(Arguments,))
    fields = schema.__pydantic_fields__
    wrong = {
        name: object()
        for name, info in fields.items()
        if info.metadata or info.annotation not in (Any, object)
    }
    every = inspect.signature(function).parameters.values()
    first = [p.name for p in every if p.kind is p.POSITIONAL_ONLY]
    named: dict[str, Any] = {p.name: None for p in every if p.name in ("self", "cls")}
    named |= {name: value for name, value in wrong.items() if name not in first}
    with pytest.raises(FieldErrors) as caught:
        function(*(wrong[name] for name in first), **named)
    assert {re.split(r"[ :]", line)[0] for line in str(caught.value).splitlines()} == {*wrong}
