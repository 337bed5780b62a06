"""What is wrong with settings, in the words of error messages."""

from collections.abc import Iterable
from difflib import SequenceMatcher
from typing import Any


def explain(name: str, errors: list[Any], *, value: Any, known: Iterable[str]) -> str:
    """Return a line about what pydantic found wrong with a field."""
    kind = errors[0]["type"]
    if kind == "unexpected_keyword_argument":
        return f"{name}: there is no such setting{suggest(name, known)}"
    if kind == "missing" and len(errors[0]["loc"]) == 1:
        return f"{name}: has no default, so it must be given"
    entries = [e["loc"][1] for e in errors if e["type"] == "missing"]
    if entries:  # of a tuple
        return f"{name} = {_show(value)}: must be a list of {max(entries) + 1}"
    reasons = dict.fromkeys(_say(error) for error in errors)
    is_choice = all(isinstance(part, str) for error in errors for part in error["loc"])
    return f"{name} = {_show(value)}: must be {' or '.join([*reasons][: None if is_choice else 1])}"


def _say(error: Any) -> str:
    """Return what a value should be, for an error of pydantic."""
    kind, ctx = error["type"], error.get("ctx", {})
    words = {
        "int_type": "a whole number",
        "float_type": "a number",
        "bool_type": "true or false",
        "string_type": "a word",
        "tuple_type": "a list",
        "none_required": "null",
        "literal_error": "{expected}",
        "is_instance_of": "of type {class}",
        "dataclass_type": "of type {class_name}",
        "greater_than": "greater than {gt:g}",
        "greater_than_equal": "at least {ge:g}",
        "less_than": "less than {lt:g}",
        "less_than_equal": "at most {le:g}",
        "too_short": "a list of at least {min_length}",
        "too_long": "a list of at most {max_length}",
    }
    if kind == "literal_error":
        choices = str(ctx["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        return f"{ctx['expected']}{suggest(str(error['input']), choices)}"
    if kind == "value_error":  # of a validator, which completes "must be ..."
        return str(ctx["error"])
    return words[kind].format(**ctx) if kind in words else str(error["msg"])


def _show(value: Any) -> str:
    return repr(value) if isinstance(value, str) else str(value)


def suggest(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the most similar known word, or nothing.

    Dotted keys are compared as a whole and by their last part. A short word must be more similar,
    unless it is part of the known one.
    """
    tail = word.rpartition(".")[2]

    def rate(other: str) -> tuple[bool, float]:
        known_tail = other.rpartition(".")[2]
        of_tail = SequenceMatcher(None, tail, known_tail).ratio()
        least = 0.6 if len(tail) >= 8 or tail in known_tail else 0.75
        return of_tail >= least, of_tail + SequenceMatcher(None, word, other).ratio()

    best = max(known, key=rate, default="")
    return f"; did you mean {best!r}?" if rate(best)[0] else ""
