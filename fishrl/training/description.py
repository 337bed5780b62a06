"""Tasks, algorithms and loggers as plain nested dicts, and back: what run files contain.

A description is ``{"_target_": "module.Class", argument: value, ...}``; values are numbers, words,
lists, dicts or descriptions. Reading one makes only classes of the kind that is expected, from
fishrl or from modules that the user has imported or named: a file cannot choose other code.
"""

from __future__ import annotations

import importlib
import inspect
import sys
import typing
from collections.abc import Collection, Iterator, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar

import numpy as np

from fishrl.bounds import suggest
from fishrl.training.aliases import ALIASES

T = TypeVar("T")
TARGET = "_target_"


def describe(made: Any) -> dict[str, Any]:
    """Return class and constructor arguments of an object; the inverse of ``make``.

    An object keeps each constructor argument as an attribute of the same name; else, and for what
    cannot be written into a file, a ValueError is raised.
    """
    kind = type(made)
    module = find_main() if kind.__module__ == "__main__" else kind.__module__
    target = f"{module}.{kind.__qualname__}"
    described: dict[str, Any] = {TARGET: target}
    for name in inspect.signature(kind).parameters:
        if not hasattr(made, name):
            raise ValueError(f"{target}: keep the argument {name!r} as an attribute of that name")
        described[name] = to_plain(getattr(made, name))
    return described


def find_main() -> str:
    """Return the name under which other programs can import the script that runs."""
    main = sys.modules["__main__"]
    if (spec := getattr(main, "__spec__", None)) is not None:
        return str(spec.name)
    return Path(getattr(main, "__file__", "__main__")).stem


def to_plain(value: Any) -> Any:
    """Turn a value into what JSON and YAML hold: tuples into lists, objects into descriptions."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): to_plain(item) for name, item in value.items()}
    if callable(value):
        raise ValueError(f"{value!r}: cannot be written into a file")
    return describe(value)


def make(node: Any, *, kind: type[T] | tuple[type[T], ...], modules: Collection[str] = ()) -> T:
    """Make the object of a description.

    Args:
        node: the description.
        kind: class that the object must be an instance of. Objects among its arguments must be of
            the kind that the annotation of the argument names.
        modules: modules and packages outside fishrl, named by the user, that may be imported for
            it; modules that are already imported need not be named.

    Raises:
        ValueError: if there is no such class, it is of another kind or from a module that is not
            allowed, or it does not take the arguments.
    """
    if not isinstance(node, Mapping) or not isinstance(node.get(TARGET), str):
        raise ValueError(f"{node!r}: give a {TARGET} and its arguments")
    made = find_class(node[TARGET], kind=kind, modules=modules)
    known = inspect.signature(made).parameters
    given = {name: value for name, value in node.items() if name != TARGET}
    for name in given:
        if name not in known:
            raise ValueError(f"{node[TARGET]}: there is no {name!r}{suggest(name, known)}")
    try:
        return made(**{n: _make_parts(v, made, n, modules=modules) for n, v in given.items()})
    except TypeError as error:
        raise ValueError(f"{node[TARGET]}: {error}") from error


def _make_parts(value: Any, owner: type, name: str, *, modules: Collection[str]) -> Any:
    """Make the descriptions in an argument, of the kinds that its annotation allows."""
    hints = typing.get_type_hints(owner if is_dataclass(owner) else owner.__init__)  # type: ignore[misc]
    hint = hints.get(name)
    kinds = tuple(list_classes(hint))
    if isinstance(value, list):
        value = [_make_parts(item, owner, name, modules=modules) for item in value]
    elif isinstance(value, Mapping) and TARGET in value:
        value = make(value, kind=kinds, modules=modules)
    is_union = typing.get_origin(hint) in (typing.Union, UnionType)
    choices = typing.get_args(hint) if is_union else (hint,)
    if kinds and {*choices} <= {*kinds, type(None)} and not isinstance(value, choices):
        raise ValueError(f"{name} = {value}: must be {' or '.join(k.__name__ for k in choices)}")
    return value


def list_classes(hint: Any) -> Iterator[type]:
    """List the classes in an annotation such as ``Steering | None`` that an object may be of."""
    plain = (Any, object, str, int, float, bool, bytes, type(None))
    if isinstance(hint, type) and typing.get_origin(hint) is None and hint not in plain:
        yield hint
    for part in typing.get_args(hint):
        yield from list_classes(part)


def find_class(
    name: str, *, kind: type[T] | tuple[type[T], ...], modules: Collection[str] = ()
) -> type[T]:
    """Return the class of a dotted name, which may be a former one; see ``make``."""
    module, _, last = ALIASES.get(name, name).rpartition(".")
    loaded = sys.modules.get("__main__" if module == find_main() else module)
    if loaded is None and any(f"{module}.".startswith(f"{own}.") for own in ("fishrl", *modules)):
        try:
            loaded = importlib.import_module(module)
        except (ImportError, ValueError) as error:
            raise ValueError(f"{TARGET}: {name}: {error} (is its folder on PYTHONPATH?)") from error
    if loaded is None:
        raise ValueError(
            f"{TARGET}: {name}: module {module!r} is not imported; if you trust it, give "
            f"modules=[{module}]"
        )
    found = getattr(loaded, last, None)
    if not isinstance(found, type) or not issubclass(found, kind):
        kinds = kind if isinstance(kind, tuple) else (kind,)
        wanted = " or ".join(one.__name__ for one in kinds) or "plain value"
        raise ValueError(f"{TARGET}: {name}: is no {wanted}")
    return found
