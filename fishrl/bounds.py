"""Bounds of settings, declared with the field they belong to and checked by one function."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, field, fields, is_dataclass
from difflib import SequenceMatcher
from numbers import Real
from typing import Any

#: What an integer must be; neither omegaconf nor torch takes others.
FITTING = "a number of at most 64 bits"

#: Annotation of a tuple with one type for each of its entries.
FIXED = re.compile(r"tuple\[(\w+(?:, \w+)+)\](?: \| None)?")

#: How deep sequences are searched for numbers where the annotation does not say.
MAX_DEPTH = 8


def bounded(
    default: Any = MISSING,
    *,
    least: float | None = None,
    greater: float | None = None,
    largest: float | None = None,
    less: float | None = None,
    entries: int | None = None,
    norm: float | None = None,
) -> Any:
    """Return a dataclass field whose numbers ``check_bounds`` keeps within bounds.

    Args:
        default: of the field; without one it has to be given.
        least: smallest allowed value.
        greater: the value must be greater than this.
        largest: largest allowed value.
        less: the value must be less than this.
        entries: smallest number of values in a sequence.
        norm: largest Euclidean norm of a sequence, or absolute value of a number.
    """
    bounds = {"least": least, "greater": greater, "largest": largest, "less": less}
    bounds |= {"entries": entries, "norm": norm}
    return field(default=default, metadata={k: v for k, v in bounds.items() if v is not None})


class Checked:
    """Base of dataclasses whose numbers are checked as they are made, by ``check_bounds``."""

    def __post_init__(self) -> None:
        """Check the bounds; call it in that of a subclass."""
        check_bounds(self)


def check_bounds(settings: Any, *, path: str = "") -> None:
    """Check every number in a dataclass: finite, whole, within 64 bits and its bounds.

    Those in sequences and in dataclasses that it holds are checked, too. A field without bounds may
    hold anything but NaN and infinity; an optional one may be None. Lists become tuples, which have
    a hash, unless the annotation says ``list``. One like ``tuple[float, float]`` needs as many
    numbers, which become floats.

    Args:
        settings: the dataclass.
        path: of a dataclass within another, such as ``gait.``, for messages.

    Raises:
        ValueError: naming the field, its value and what is allowed.
    """
    for entry in fields(settings):
        value = getattr(settings, entry.name)
        if isinstance(value, Real) and hasattr(value, "item"):  # of NumPy
            value = value.item()
            object.__setattr__(settings, entry.name, value)
        bounds: dict[str, float] = {}  # a subclass that changes a default keeps the bounds
        for kind in reversed(type(settings).__mro__):
            inherited = getattr(kind, "__dataclass_fields__", {}).get(entry.name)
            bounds |= inherited.metadata if inherited else {}
        hint = str(entry.type).removeprefix("<class '").removesuffix("'>")
        numbers = list(_flatten(value, depth=hint.count("[") or MAX_DEPTH))
        allowed = "" if len(numbers) >= bounds.get("entries", 0) else _describe(bounds)
        fixed = FIXED.fullmatch(hint)
        kinds = fixed[1].split(", ") if fixed and value is not None else [hint]
        if len(kinds) > 1 and not (isinstance(value, list | tuple) and len(value) == len(kinds)):
            allowed = f"a list of {len(kinds)}"
        if hint.startswith("tuple[") and not isinstance(value, list | tuple):
            allowed = "" if value is None and "None" in hint else "a list"
        for number in numbers:
            if is_dataclass(number) and not isinstance(number, type):
                check_bounds(number, path=f"{path}{entry.name}.")
            allowed = allowed or _find_violation(number, kind=kinds[0], bounds=bounds)
        if not allowed and "norm" in bounds and math.hypot(*numbers) > bounds["norm"]:
            allowed = _describe(bounds)
        if allowed:
            raise ValueError(f"{path}{entry.name} = {value}: must be {allowed}")
        if isinstance(value, list) and "list" not in hint:
            value = _freeze(value)
            object.__setattr__(settings, entry.name, value)
        if len(kinds) > 1 and set(kinds) == {"float"}:
            object.__setattr__(settings, entry.name, tuple(map(float, value)))


def _flatten(value: Any, *, depth: int) -> Iterator[Any]:
    """Return the values in sequences one by one, nested no deeper than the annotation allows."""
    if isinstance(value, list | tuple) and depth:
        for entry in value:
            yield from _flatten(entry, depth=depth - 1)
    else:
        yield value


def _freeze(value: Any) -> Any:
    return tuple(map(_freeze, value)) if isinstance(value, list | tuple) else value


def is_huge(number: Any) -> bool:
    """Tell whether a value is a whole number of more than 64 bits."""
    return isinstance(number, int) and abs(number) >= 2**63


def _find_violation(number: Any, *, kind: str, bounds: Any) -> str:
    """Return what the number should be and is not; nothing if all is well."""
    is_number = isinstance(number, int | float) and not isinstance(number, bool)
    if "None" in kind and number is None:
        return ""
    if not is_number:
        return "a number" if bounds or kind in ("int", "float") else ""
    if is_huge(number):
        return FITTING
    if not math.isfinite(number):
        return _describe(bounds, "finite")
    is_whole = "int" in kind and "float" not in kind
    if is_whole and not isinstance(number, int):
        return "a whole number"
    is_allowed = (
        number >= bounds.get("least", -math.inf)
        and number > bounds.get("greater", -math.inf)
        and number <= bounds.get("largest", math.inf)
        and number < bounds.get("less", math.inf)
    )
    return "" if is_allowed else _describe(bounds)


def _describe(bounds: Any, *first: str) -> str:
    words = {"least": "at least", "greater": "greater than", "largest": "at most"}
    words |= {"less": "less than", "entries": "a list with a length of at least"}
    words |= {"norm": "of a norm of at most"}
    return ", ".join(
        (*first, *(f"{word} {bounds[name]}" for name, word in words.items() if name in bounds))
    )


def suggest(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the most similar known word, or nothing.

    Dotted keys are compared as a whole and by their last part.
    """

    def rate(other: str) -> tuple[bool, float]:
        tails = (word.rpartition(".")[2], other.rpartition(".")[2])
        of_tail = SequenceMatcher(None, *tails).ratio()
        return of_tail >= 0.6, of_tail + SequenceMatcher(None, word, other).ratio()

    best = max(known, key=rate, default="")
    return f"; did you mean {best!r}?" if rate(best)[0] else ""
