"""The base of settings: frozen dataclasses that check the types and bounds of their fields."""

import inspect
import math
import types
import typing
from collections import ChainMap
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, field
from enum import Enum
from functools import cache, wraps
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar, dataclass_transform

import numpy as np
import pydantic
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo
from pydantic_core import ArgsKwargs, PydanticUndefined, core_schema

from fishrl.settings.messages import explain

P = ParamSpec("P")
R = TypeVar("R")
#: Default of a field that must be given.
REQUIRED: Any = inspect.Parameter.empty

_CONFIG = pydantic.ConfigDict(
    strict=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False
)


class Role(Enum):
    """Effect of a setting on a training; stated in the annotation of its field."""

    RESULT = "what is learned"  # of a field that states none; fixed once a run has begun
    CONTINUATION = "what is learned from where a run continues"
    EVALUATION = "the final evaluation alone"
    HARMLESS = "what is logged, saved or shown"


class FieldErrors(ValueError):
    """Invalid fields: a line for each, which begins with its name."""


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(field, pydantic.Field)
)
class Settings:
    """Base of settings: each subclass is a frozen, keyword-only dataclass that checks its fields.

    Numbers are finite, integers have at most 64 bits, and strings are printable and of one line.
    Only NumPy's numbers, integers where a float is expected, and lists, which become tuples, are
    converted. A subclass, which needs no decorator, repeats the type of a field whose
    default it changes and keeps bounds and role. Checks that concern several fields belong in
    ``__post_init__``.

    Attributes:
        former: what to give in place of settings that are gone, by their names; with the bases'.

    Raises:
        ValueError: with a line per error, ``name = value: must be ...``.
    """

    former: typing.ClassVar[Mapping[str, str]] = {}

    if TYPE_CHECKING:
        __dataclass_fields__: typing.ClassVar[dict[str, Field[Any]]]
        __pydantic_fields__: typing.ClassVar[dict[str, FieldInfo]]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.former = dict(ChainMap(*(dict(vars(base).get("former", {})) for base in cls.__mro__)))
        annotated, inherited = inspect.get_annotations(cls), dict[str, FieldInfo]()
        for base in reversed(cls.__mro__[1:]):
            inherited |= vars(base).get("__pydantic_fields__", {})
        for name, info in inherited.items():
            if name in annotated and "ClassVar" not in str(annotated[name]):
                setattr(cls, name, _keep_bounds(info, vars(cls).get(name, info)))
            elif name in vars(cls) and name not in annotated:
                raise TypeError(f"{cls.__name__}.{name} changes a field: repeat its type")
        dataclass(config=_CONFIG, frozen=True, kw_only=True)(cls)
        cls.__init__ = _check_init  # type: ignore[method-assign, assignment]

    def __post_init__(self) -> None:
        """Check what concerns several fields."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> core_schema.CoreSchema:
        """Return the schema; an object in a field has been checked, so its class suffices."""
        if vars(cls).get("__pydantic_complete__"):
            return core_schema.is_instance_schema(cls)
        schema: core_schema.CoreSchema = handler(source)
        return schema


def _keep_bounds(inherited: FieldInfo, given: Any) -> FieldInfo:
    """Return a field with its own default, and with the bounds and role of its base class."""
    is_field = isinstance(given, Field | FieldInfo)
    default = given.default if is_field else given
    factory = given.default_factory if is_field else None
    if callable(factory):
        info = pydantic.Field(default_factory=factory)
    else:
        info = pydantic.Field(
            default=... if default is MISSING or default is PydanticUndefined else default
        )
    own = given.metadata if isinstance(given, FieldInfo) and given is not inherited else ()
    info.metadata = [*inherited.metadata, *own]
    return typing.cast(FieldInfo, info)


def _check_init(self: Any, /, *unnamed: Any, **values: Any) -> None:
    """Check and set the fields: the constructor of all settings."""
    if unnamed:
        entries = sorted(list_fields(type(self)), key=lambda entry: entry.default is not REQUIRED)
        named = (f"{entry.name}={value!r}" for entry, value in zip(entries, unnamed, strict=False))
        name = type(self).__name__
        raise TypeError(f"{name} takes its settings by name, such as {name}({', '.join(named)})")
    lines: dict[str, str] = {}
    for name, value in values.items():
        try:
            values[name] = _to_python(value)
        except ValueError as error:
            lines[name] = f"{name} = {value!r}: must be {error}"
    try:
        self.__pydantic_validator__.validate_python(ArgsKwargs((), values), self_instance=self)
    except pydantic.ValidationError as error:
        found = error.errors(include_url=False)
        if not found[0]["loc"] and not lines:  # raised by __post_init__
            raise found[0]["ctx"]["error"] from None
        known = type(self).__pydantic_fields__
        lines = {str(e["loc"][0]): "" for e in found if e["loc"]} | lines
        for name in lines:
            of_name = [entry for entry in found if entry["loc"] and entry["loc"][0] == name]
            if name in self.former:
                lines[name] = f"{name}: {self.former[name]}"
            lines[name] = lines[name] or explain(name, of_name, value=values.get(name), known=known)
    if lines:
        raise FieldErrors("\n".join(lines.values()))


def _to_python(value: Any) -> Any:
    """Convert lists to tuples and NumPy's numbers to Python's; refuse infinite and huge ones."""
    if isinstance(value, np.generic):
        value = value.item()
    if type(value) in (list, tuple):
        return tuple(_to_python(entry) for entry in value)
    if isinstance(value, int) and abs(value) >= 2**63:
        raise ValueError("an integer of at most 64 bits")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("finite")
    if isinstance(value, str) and not value.isprintable():
        raise ValueError("a printable string without line breaks")
    return value


class Entry(NamedTuple):
    """A field of a class: what its constructor takes."""

    name: str
    type: Any
    default: Any
    role: Role


def list_fields(kind: type) -> list[Entry]:
    """List the arguments of a constructor; those without a default have ``REQUIRED``."""
    entries = []
    for name, info in find_schema(kind).__pydantic_fields__.items():
        if info.init is False:
            continue
        role = next((mark for mark in info.metadata if isinstance(mark, Role)), Role.RESULT)
        factory: Any = info.default_factory
        default = factory() if factory is not None else info.default
        default = REQUIRED if default is PydanticUndefined else default
        entries.append(Entry(name, info.annotation, default, role))
    return entries


def find_role(kind: type, key: str) -> Role:
    """Return the role of a setting by its dotted key: its own, or else that of its object."""
    name, _, rest = key.partition(".")
    entry = next((entry for entry in list_fields(kind) if entry.name == name), None)
    if entry is None or entry.role is Role.HARMLESS:
        return Role.RESULT if entry is None else entry.role
    is_part = rest and isinstance(entry.type, type) and issubclass(entry.type, Settings)
    below = find_role(entry.type, rest) if is_part else Role.RESULT
    return entry.role if below is Role.RESULT else below


@cache
def find_schema(
    called: Callable[..., Any],
    *,
    without: tuple[str, ...] = (),
    bases: tuple[type[Settings], ...] = (Settings,),
) -> type[Settings]:
    """Return a ``Settings`` class as it is, or make one of another class or of a function.

    Its fields are the named arguments and the fields of ``bases``; ``without`` names arguments that
    are not settings. An argument whose default is ``...`` may be left out, and is None then.
    """
    if isinstance(called, type) and issubclass(called, Settings):
        return called
    function = inspect.getattr_static(called, "__init__") if isinstance(called, type) else called
    hints = typing.get_type_hints(function, include_extras=True)
    given = inspect.signature(called).parameters.values()
    open_ended = inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD
    fields = [p for p in given if p.kind not in open_ended and p.name not in without]
    body: dict[str, Any] = {p.name: p.default for p in fields if p.default is not p.empty}
    body = {name: None if default is ... else default for name, default in body.items()}
    body["__annotations__"] = {p.name: _loosen(hints.get(p.name, Any)) for p in fields}
    body |= {"__module__": called.__module__, "__doc__": called.__doc__}
    return type(called.__name__, bases, body)


class Arguments(Settings):
    """Base of the classes whose fields are the arguments of a function that checks them."""


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function check its arguments by their annotations, as settings check their fields.

    It gets what the caller gave, NumPy's numbers as Python's; ``*args`` and ``**kwargs`` are not
    checked. The errors are Python's, and ValueError with a line per wrong argument.
    """
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        schema = find_schema(function, without=("self", "cls"), bases=(Arguments,))
        fields, given = schema.__pydantic_fields__, bound.arguments
        schema(**{name: value for name, value in given.items() if name in fields})
        for name, value in given.items():
            given[name] = value.item() if isinstance(value, np.generic) else value
        return function(*bound.args, **bound.kwargs)

    return call


def _loosen(hint: Any) -> Any:
    """Return an annotation for arguments: named tuples are not made anew, ``...`` is no value."""
    if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):

        def check(value: Any) -> Any:
            if not isinstance(value, hint):
                raise ValueError(f"an instance of {hint.__name__}")
            return value

        return typing.Annotated[Any, pydantic.PlainValidator(check)]
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        parts = (_loosen(part) for part in typing.get_args(hint) if part is not types.EllipsisType)
        return typing.Union[tuple(parts)]  # noqa: UP007
    return hint
