"""Error messages of settings: one line per field, with the nearest right word."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from enum import Enum
from inspect import isabstract
from typing import Any, get_args, get_origin


def explain(name: str, errors: list[Any], *, value: Any, known: Mapping[str, Any]) -> str:
    """Return one line for all errors that pydantic found in a field."""
    kind = errors[0]["type"]
    if kind == "unexpected_keyword_argument":
        return f"{name}: there is no such setting{suggest(name, known)}"
    if kind == "missing" and len(errors[0]["loc"]) == 1:
        return f"{name}: has no default, so it must be given"
    hint = getattr(known.get(name), "annotation", None)
    reasons = dict.fromkeys(_say(error, hint) for error in errors)
    lengths = [error["loc"][-1] + 1 for error in errors if error["type"] == "missing"]
    if lengths:
        reasons.pop("", None)
        reasons[f"be a list of {max(lengths)}"] = None
    first, *others = reasons
    is_union = all(isinstance(part, str) for error in errors for part in error["loc"][:2])
    if is_union:
        first = " or ".join([first, *(reason.removeprefix("be ") for reason in others)])
    return f"{name} = {_show(value)}: must {first}"


def _say(error: Any, hint: Any) -> str:
    """Return the condition that a value violates, such as ``be greater than 0``."""
    if error["type"] == "is_instance_of":
        if isinstance(error["input"], type):
            return f"be an object, such as {error['input'].__name__}(...)"
        members = dict.fromkeys(_list_members(hint, error["ctx"]["class"]))
        return (
            f"be {' or '.join(members)}" if members else str(error["msg"]).partition(" should ")[2]
        )
    if error["type"] == "tuple_type" and isinstance(error["input"], int | float | str):
        given = [str(error["input"]).strip("()[]")] * _count_entries(hint)
        return f"be a list, such as [{', '.join(given)}]"
    if error["type"] == "value_error":  # of a validator, which completes "must be ..."
        return f"be {error['ctx']['error']}"
    said = str(error["msg"]).partition(" should ")[2]
    said = said.replace("a valid tuple", "a list").replace(" after validation", "")
    if error["type"] == "literal_error":
        choices = str(error["ctx"]["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        said += suggest(str(error["input"]), choices)
    return said


def _list_members(hint: Any, name: str) -> Iterator[str]:
    """List what may stand where an annotation has a class of a name, as one writes it in Python."""
    for part in get_args(hint):
        yield from _list_members(part, name)
    if isinstance(hint, type) and hint.__name__ == name:
        if issubclass(hint, Enum):
            yield from (f"{name}.{member.name}" for member in hint)
        kinds = [hint]
        for kind in kinds:
            kinds += kind.__subclasses__()
            is_public = hasattr(kind, "__pydantic_fields__") and not kind.__name__.startswith("_")
            if is_public and not isabstract(kind):
                yield f"{kind.__name__}(...)"


def _count_entries(hint: Any) -> int:
    """Return how many entries the lists of an annotation have, 1 where any number will do."""
    parts = get_args(hint)
    if get_origin(hint) is tuple:
        return 1 if ... in parts else len(parts)
    return max(map(_count_entries, parts), default=1)


def _show(value: Any) -> str:
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) < 200 and "\n" not in text else f"{type(value).__name__}(...)"


def suggest(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the most similar known word, or nothing.

    Dotted keys are compared as a whole and by their last part. A short word must be more similar,
    unless it is part of the known one, and so must one of another group.
    """
    group, _, tail = word.rpartition(".")

    def rate(other: str) -> tuple[bool, float]:
        known_group, _, known_tail = other.rpartition(".")
        of_tail = SequenceMatcher(None, tail, known_tail).ratio()
        least = 0.6 if len(tail) >= 8 or tail in known_tail else 0.75
        least = least if group in ("", known_group) else 0.85
        return of_tail >= least, of_tail + SequenceMatcher(None, word, other).ratio()

    best = max(known, key=rate, default="")
    return f"; did you mean {best!r}?" if rate(best)[0] else ""


def unknown(word: str, known: Sequence[str]) -> ValueError:
    """Return the error for an unknown word, with the nearest known one or the whole list."""
    near = suggest(word, known) or f". There is: {', '.join(known)}."
    return ValueError(f"there is no {word!r}{near}")
