"""Objects as plain nested data, as hydra composes it and files store it, and back.

The data of an object are ``{"_target_": "module.Class", argument: value, ...}``; values are
numbers, words, lists, mappings or the data of other objects. A word stands for an object where the
type of a field is a class of settings: ``immersed-boundary`` for ``ImmersedBoundary()``. Building
makes only classes of the type that a field asks for, from fishrl or from modules that the user has
imported or named: a file cannot choose other code.
"""

import importlib
import inspect
import re
import sys
import typing
from collections.abc import Collection, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fishrl.settings.base import REQUIRED, FieldErrors, Settings, find_schema, list_fields
from fishrl.settings.messages import suggest

T = TypeVar("T")
TARGET = "_target_"


def describe(made: Any) -> dict[str, Any]:
    """Return an object as ``{"_target_": "module.Class", argument: value, ...}``, plain data.

    An object keeps each argument of its constructor as an attribute of the same name.

    Raises:
        ValueError: if it does not, or holds what cannot be written into a file.
    """
    kind = type(made)
    module = find_main() if kind.__module__ == "__main__" else kind.__module__
    described: dict[str, Any] = {TARGET: f"{module}.{kind.__qualname__}"}
    for name in inspect.signature(kind).parameters:
        if not hasattr(made, name):
            raise ValueError(f"{described[TARGET]}: keep the argument {name!r} as an attribute")
        described[name] = to_plain(getattr(made, name))
    return described


def to_plain(value: Any) -> Any:
    """Return a value as JSON and YAML hold it: lists, mappings, and objects as described."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Enum):
        return _spell(value.name)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(name): to_plain(item) for name, item in value.items()}
    if isinstance(value, type) or inspect.isroutine(value):
        raise ValueError(f"{value!r}: cannot be written into a file")
    return describe(value)


def flatten(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested plain data by dotted keys."""
    flat: dict[str, Any] = {}
    for name, value in node.items():
        key = f"{prefix}{name}"
        flat |= flatten(value, f"{key}.") if isinstance(value, Mapping) else {key: value}
    return flat


def find_main() -> str:
    """Return the importable name of the running script."""
    main = sys.modules["__main__"]
    if (spec := getattr(main, "__spec__", None)) is not None:
        return str(spec.name)
    return Path(getattr(main, "__file__", "__main__")).stem


def build(kind: type[T] | tuple[type[T], ...], node: Any, *, modules: Collection[str] = ()) -> T:
    """Make an object of plain nested data.

    Args:
        kind: class of the object or a base of it, or several.
        node: its arguments. ``_target_`` names the class, as ``module.Class`` or by its word;
            without it, arguments of an object in a field change the default of that field, or make
            the only class that has them.
        modules: modules outside fishrl that may be imported for a ``_target_``, named by the user
            and never by a file. Those that are imported already need not be named.

    Raises:
        ValueError: with a line per error, for unknown and missing keys, wrong types and bounds,
            and classes that are not of the type that the field asks for.
    """
    builder = _Builder(modules)
    made = builder.make(node, kind if isinstance(kind, tuple) else (kind,), path="")
    errors = [*(_refuse(key, builder.known) for key in builder.unknown), *builder.errors]
    if errors:
        error, cause = ValueError("\n".join(errors)), builder.cause
        raise error.with_traceback(cause.__traceback__ if cause else None) from cause
    return typing.cast(T, made)


def _refuse(key: str, known: Sequence[str]) -> str:
    """Return the error for an unknown key, with the nearest known one or the whole list."""
    place = key.rpartition(".")[0]
    here = [name.rpartition(".")[2] for name in known if name.rpartition(".")[0] == place]
    there = f". There is: {', '.join(here)}" if here else ""
    return f"there is no {key!r}{suggest(key, known) or there}"


class _Builder:
    """Makes nested objects, and continues after an error so that all are reported."""

    def __init__(self, modules: Collection[str]) -> None:
        self.modules = modules
        self.errors: list[str] = []
        self.unknown: list[str] = []
        self.known: list[str] = []  # dotted keys of all classes that occur
        self.cause: Exception | None = None

    def make(self, node: Any, kinds: tuple[type, ...], *, path: str, default: Any = None) -> Any:
        """Return the object of a node, or None after an error."""
        prefix = f"{path}." if path else ""
        if isinstance(node, str) and (words := list_words(*kinds)):
            return self._make_named(node, words, path, kinds[0])
        try:
            kind = self._find_kind(node, kinds, default)
        except ValueError as error:
            self.errors.append(f"{path}: {error}" if path else str(error))
            return None
        entries = {entry.name: entry for entry in list_fields(kind)}
        # a default of another class may have been expected here
        self.known = [key for key in self.known if not key.startswith(prefix)]
        self._learn_keys(kind, prefix)
        values: dict[str, Any] = {}
        if TARGET not in node and isinstance(default, Settings):
            values = {name: getattr(default, name) for name in entries}
        failed = []
        for name, value in node.items():
            if name in entries:
                count = len(self.errors)
                below = values.get(name, entries[name].default)
                values[name] = self._make_part(value, entries[name].type, prefix + name, below)
                failed += [name][: len(self.errors) - count]
            elif issubclass(kind, Settings) and name in kind.former:
                self.errors.append(f"{prefix}{name}: {kind.former[name]}")
            elif name != TARGET:
                self.unknown.append(prefix + name)
        values = {name: value for name, value in values.items() if name not in failed}
        try:
            return _call(kind, values)
        except FieldErrors as error:
            lines = [line for line in str(error).splitlines() if line.split(":")[0] not in failed]
            self.errors += [prefix + line for line in lines]
        except (TypeError, ValueError) as error:  # of __post_init__; it may follow from the others
            if not failed:
                is_of_field = str(error).split(" ")[0].rstrip(":") in entries
                start = prefix if is_of_field or not path else f"{path}: "
                self.errors.append(f"{start}{error}")
                self.cause = error
        return None

    def _find_kind(self, node: Any, kinds: tuple[type, ...], default: Any) -> type:
        """Return the class that a node names, else that of the default, else of the annotation."""
        if isinstance(node, Mapping):
            if TARGET in node:
                return find_class(str(node[TARGET]), kinds, modules=self.modules)
            if isinstance(default, Settings):
                return type(default)
            fitting = [kind for kind in _list_kinds(*kinds) if {*node} <= _name_fields(kind)]
            if len(fitting) == 1:
                return fitting[0]
            if len(kinds) == 1 and not inspect.isabstract(kinds[0]):
                return kinds[0]
        raise ValueError(f"give a {TARGET} and its arguments; got {node!r}")

    def _make_part(self, value: Any, hint: Any, path: str, default: Any) -> Any:
        """Return a value with objects in place of their nodes, of the types in an annotation."""
        kinds = tuple(dict.fromkeys(list_classes(hint)))
        if isinstance(value, Mapping):
            is_mapping = any(issubclass(kind, Mapping) for kind in kinds)
            if TARGET in value or isinstance(default, Settings) or (kinds and not is_mapping):
                return self.make(value, kinds, path=path, default=default)
        elif isinstance(value, list | tuple):
            return [self._make_part(item, hint, path, None) for item in value]
        elif isinstance(value, str) and (words := list_words(hint)):
            return self._make_named(value, words, path, hint)
        return value

    def _make_named(self, word: str, words: Mapping[str, Any], path: str, hint: Any) -> Any:
        """Return the object, or the member of an enumeration, that a word stands for."""
        if (found := words.get(_spell(word))) is not None:
            return self.make({}, (found,), path=path) if isinstance(found, type) else found
        others = [kind for kind in _list_kinds(hint) if kind not in words.values()]
        more = "".join(f", or give {path}.{_list_required(kind)[0]}=..." for kind in others)
        reason = f"must be one of {', '.join(words)}{more}{suggest(_spell(word), words)}"
        self.errors.append(f"{path} = {word!r}: {reason}" if path else f"{word!r}: {reason}")
        return None

    def _learn_keys(self, kind: type, prefix: str) -> None:
        """Remember the keys of a class and of the objects in its fields by default."""
        for entry in list_fields(kind):
            self.known.append(f"{prefix}{entry.name}")
            if isinstance(entry.default, Settings):
                self._learn_keys(type(entry.default), f"{prefix}{entry.name}.")


def _spell(name: str) -> str:
    """Return the name of a member of an enumeration as users write it."""
    return name.lower().replace("_", "-")


def _call(kind: type, values: Mapping[str, Any]) -> Any:
    """Call a constructor with arguments that are checked first."""
    schema = find_schema(kind)
    checked = schema(**values)
    return checked if schema is kind else kind(**{n: getattr(checked, n) for n in values})


def list_classes(hint: Any) -> Iterator[type]:
    """List the classes in an annotation such as ``Steering | None`` that an object may be of."""
    plain = (Any, object, str, int, float, bool, bytes, type(None))
    if isinstance(hint, type) and typing.get_origin(hint) is None and hint not in plain:
        yield hint
    for part in typing.get_args(hint):
        yield from list_classes(part)


def list_words(*hints: Any) -> dict[str, Any]:
    """Return the members of enumerations and the classes that a field of some type takes, by word.

    The classes are those of settings that are imported, are not abstract and have defaults for all
    settings. There is none where the field may hold text.
    """
    enums = [kind for hint in hints for kind in list_classes(hint) if issubclass(kind, Enum)]
    members = {_spell(name): each for kind in enums for name, each in kind.__members__.items()}
    return members | {
        re.sub(r"(?<=[a-z\d])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "-", kind.__name__).lower(): kind
        for kind in _list_kinds(*hints)
        if not _list_required(kind)
    }


def _list_kinds(*hints: Any) -> list[type]:
    """List the concrete classes of settings that a field may hold, unless it may hold text."""
    if any(map(_may_be_text, hints)):
        return []
    kinds = [kind for hint in hints for kind in list_classes(hint) if issubclass(kind, Settings)]
    for kind in kinds:
        kinds += kind.__subclasses__()
    return [kind for kind in dict.fromkeys(kinds) if not inspect.isabstract(kind)]


def _list_required(kind: type) -> list[str]:
    return [entry.name for entry in list_fields(kind) if entry.default is REQUIRED]


def _name_fields(kind: type) -> set[str]:
    return {entry.name for entry in list_fields(kind)}


def _may_be_text(hint: Any) -> bool:
    is_text = hint in (str, Path) or typing.get_origin(hint) is typing.Literal
    return is_text or any(map(_may_be_text, typing.get_args(hint)))


def find_class(name: str, kinds: tuple[type, ...], *, modules: Collection[str] = ()) -> type:
    """Return the class of a dotted name or a word if it is one of some kinds; see ``build``."""
    if "." not in name and isinstance(known := list_words(*kinds).get(name), type):
        return known
    module, _, last = name.rpartition(".")
    loaded = sys.modules.get("__main__" if module == find_main() else module)
    if loaded is None and any(f"{module}.".startswith(f"{own}.") for own in ("fishrl", *modules)):
        try:
            loaded = importlib.import_module(module)
        except (ImportError, ValueError) as error:
            raise ValueError(f"{TARGET}: {name}: {error} (is its folder on PYTHONPATH?)") from error
    if loaded is None:
        raise ValueError(
            f"{TARGET}: {name}: module {module!r} is not imported; if you trust it, give "
            f"modules=[{module}], or import it"
        )
    found = getattr(loaded, last, None)
    if found is None:
        classes = [key for key, value in vars(loaded).items() if isinstance(value, type)]
        near = suggest(last, classes)
        raise ValueError(f"{TARGET}: {name}: module {module!r} has no {last!r}{near}")
    if not isinstance(found, type) or not issubclass(found, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        must = f"must be a subclass of {wanted}" if kinds else "this setting is no object"
        raise ValueError(f"{TARGET}: {name}: {must}")
    return found
