"""Every settings class of fishrl takes exactly what its annotations allow.

``fits`` reads an annotation independently of pydantic; values are drawn around its bounds and from
a list of odd ones.
"""

from __future__ import annotations

import copy
import math
import pickle
import random
import typing
from collections.abc import Iterator
from dataclasses import replace
from enum import Enum
from importlib import import_module
from inspect import isabstract
from pkgutil import walk_packages
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin

import annotated_types as at
import pytest
from pydantic import AfterValidator
from pydantic.fields import FieldInfo

import fishrl
from fishrl.envs import Predation
from fishrl.physics.bodies.strokes import C_START
from fishrl.settings import REQUIRED, FieldErrors, Settings, build, describe, list_fields
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.logger import CsvLogger

ODD: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 7, 100, 2**31, 2**63, -(2**64)),
    *(0.0, 0.5, 1.5, -0.5, 1e9, math.nan, math.inf, -math.inf),
    *("", "x", "1", "cpu", b"x", (), (1,), [1, 2], (0.5, 1.5), [0.5, 1.5, 2.0], ("a", "b")),
    *((1, math.nan), (None, 1), ((1.0, 2.0), (3.0, 4.0)), {"a": 1}, {1, 2}, object()),
)
#: Values of fields, where those that fit their annotations one by one do not make sense.
GIVEN: dict[str, dict[str, Any]] = {
    "NonEquilibrium": {"density": 1.0},
    "Plan": {"task": Predation()},
    "ExportSettings": {"save": "a.nc"},
    "PolicySettings": {"policy": "random"},
    "SearchSettings": {"overrides": ("gamma=interval(0.9,1)",)},
    "TrainConfig": {"task": Predation(), "algorithm": DiscreteSAC(), "logger": CsvLogger()},
    "Strokes": {"sequence": C_START.sequence},
    "FlowConfig": {"width": 64, "height": 48, "tau": 0.6},
    "Gait": {"amplitude": 0.1, "envelope": (0.3, 0.1, 0.6), "wavenumber": 6.0},
    "Scales": {"body_length": 32, "reynolds": 500.0, "period": 1000},
}


def list_settings() -> list[type[Settings]]:
    names = [module.name for module in walk_packages(fishrl.__path__, "fishrl.")]
    modules = [import_module(n) for n in names if ".fast" not in n]  # which needs triton
    found = {
        f"{module.__name__}.{name}": kind
        for module in modules
        for name, kind in vars(module).items()
        if isinstance(kind, type) and issubclass(kind, Settings) and kind is not Settings
        if kind.__module__ == module.__name__ and not isabstract(kind)
    }
    return [found[name] for name in sorted(found)]


KINDS = list_settings()
assert {"FlowConfig", "Predation", "DiscreteSAC", "Plan"} <= {kind.__name__ for kind in KINDS}


def read_bounds(metadata: typing.Iterable[Any]) -> Iterator[Any]:
    for mark in metadata:
        if isinstance(mark, FieldInfo):
            yield from read_bounds(mark.metadata)
        elif isinstance(mark, at.GroupedMetadata):
            yield from read_bounds(mark)
        else:
            yield mark


def is_within(value: Any, mark: Any) -> bool:
    match mark:
        case at.Ge(bound):
            return bool(value >= bound)
        case at.Gt(bound):
            return bool(value > bound)
        case at.Le(bound):
            return bool(value <= bound)
        case at.Lt(bound):
            return bool(value < bound)
        case at.MinLen(bound):
            return len(value) >= bound
        case AfterValidator():
            try:
                mark.func(value)  # type: ignore[call-arg]
            except ValueError:
                return False
    return True


def is_finite(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(map(is_finite, value))
    if isinstance(value, float):
        return math.isfinite(value)
    return not isinstance(value, int) or abs(value) < 2**63


def fits(value: Any, hint: Any, metadata: typing.Iterable[Any] = ()) -> bool:
    """Tell whether a value is of an annotated type and within its bounds."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is typing.Annotated:
        return fits(value, parts[0], [*parts[1:], *metadata])
    if origin in (typing.Union, UnionType):
        return any(fits(value, part, metadata) for part in parts)
    if hint is Any:
        right = True
    elif origin is Literal:
        right = any(value == part and type(value) is type(part) for part in parts)
    elif origin is tuple:
        is_series = isinstance(value, list | tuple)
        each = parts[:1] * len(value) if is_series and parts[1:] == (...,) else parts
        right = is_series and len(value) == len(each) and all(map(fits, value, each))
    elif hint is float:
        right = isinstance(value, int | float) and not isinstance(value, bool)
    elif hint is int:
        right = isinstance(value, int) and not isinstance(value, bool)
    elif hint in (None, NoneType):
        right = value is None
    else:
        right = isinstance(value, origin or hint)
    if value is None and NoneType in parts:
        return True
    return right and is_finite(value) and all(is_within(value, m) for m in read_bounds(metadata))


def draw(hint: Any, generator: random.Random) -> Any:
    """Return a value that fits an annotated type more often than not."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is typing.Annotated:
        marks, names = list(read_bounds(parts[1:])), ("ge", "gt", "le", "lt")
        numbers = [getattr(mark, name) for mark in marks for name in names if hasattr(mark, name)]
        inner = draw(parts[0], generator)
        near = [b + d for b in numbers for d in (-1, -1e-3, 0, 1e-3, 1)]
        kind = parts[0] if parts[0] in (int, float) else None
        return kind(generator.choice(near)) if kind and near and generator.random() < 0.8 else inner
    if origin is Literal:
        return generator.choice(parts)
    if origin in (typing.Union, UnionType):
        return draw(generator.choice(parts), generator)
    if origin is tuple:
        num = generator.randrange(4) if parts[1:] == (...,) else len(parts)
        return tuple(draw(part, generator) for part in (parts * 4)[:num] if part is not ...)
    simple = {int: (0, 1, 3, 40), float: (0.0, 0.25, 3, 12.5), bool: (True, False), str: ("", "a")}
    if hint in simple:
        return generator.choice(simple[hint])
    if isinstance(hint, type) and issubclass(hint, Enum):
        return generator.choice(list(hint))
    return None


def make_values(kind: type[Settings]) -> dict[str, Any]:
    """Return values of the fields that have no default."""
    values: dict[str, Any] = {}
    for base in kind.__mro__:
        values |= GIVEN.get(base.__name__, {})
    for name, hint, default, _ in list_fields(kind):
        if default is REQUIRED and name not in values:
            values[name] = make_one(hint, kind.__pydantic_fields__[name].metadata)
    return values


def make_one(hint: Any, metadata: Any = ()) -> Any:
    generator = random.Random(0)
    for known in KINDS:
        if isinstance(hint, type) and issubclass(known, hint) and known.__name__ != "Plan":
            return known(**make_values(known))
    drawn = (draw(typing.Annotated[hint, *metadata, None], generator) for _ in range(200))
    for value in (20, 20.0, "a", (1.0,), (1.0, 1.0), (1.0, 1.0, 1.0), *drawn):
        if fits(value, hint, metadata):
            return value
    raise AssertionError(f"no value of {hint}")


def try_to_make(kind: type[Settings], **values: Any) -> Settings | FieldErrors:
    try:
        return kind(**values)
    except FieldErrors as error:
        return error


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_field_takes_what_its_annotation_allows_and_nothing_else(
    kind: type[Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    values, generator = make_values(kind), random.Random(0)
    monkeypatch.setattr(kind, "__post_init__", lambda _: None)
    for name, hint, _, _ in list_fields(kind):
        metadata = kind.__pydantic_fields__[name].metadata
        drawn = [draw(typing.Annotated[hint, *metadata, None], generator) for _ in range(20)]
        for value in (*ODD, *drawn):
            made = try_to_make(kind, **{**values, name: value})
            if isinstance(made, FieldErrors):
                assert not fits(value, hint, metadata), made
                assert str(made).startswith(f"{name} = ") and ": must be " in str(made)
                assert "\n" not in str(made)
            else:
                assert fits(value, hint, metadata), f"{name} = {value!r} is taken"
                assert not isinstance(getattr(made, name), list)
                assert hint is not float or type(getattr(made, name)) is float


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_settings_survive_files_copies_and_processes(kind: type[Settings]) -> None:
    made = kind(**make_values(kind))
    copies = (replace(made), build(kind, describe(made)), copy.deepcopy(made))
    for same in (*copies, pickle.loads(pickle.dumps(made))):
        assert type(same) is kind and describe(same) == describe(made)
        if not hasattr(made, "logger"):  # which equals no other
            assert same == made and hash(same) == hash(made)
