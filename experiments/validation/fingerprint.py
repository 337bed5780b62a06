"""What a job's result depends on, as one short word: unchanged jobs need not run again."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Any

import torch

from experiments.validation.case import Job
from fishrl.physics.cache_key import hash_sources


def fingerprint(job: Job) -> str:
    """Return a word that changes when the job's result may.

    It covers the function with all it calls and the constants it reads in its own package (not the
    rest of its file: a new tolerance or figure runs nothing again), the arguments, every source
    file of ``fishrl.physics`` and the version of torch. What a function imports while it runs is
    not seen: import at the top.
    """
    parts = [
        f"{job.function.__module__}.{job.function.__qualname__}",
        json.dumps(job.arguments, sort_keys=True),
        *sorted(_sources(job.function)),
        hash_sources(),
        torch.__version__,
    ]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _sources(function: Callable[..., Any]) -> set[str]:
    """Return the sources of what ``function`` reaches in its package, itself included."""
    package = function.__module__.split(".")[0]
    seen: set[str] = set()
    waiting: list[tuple[str, object]] = [(function.__qualname__, function)]
    while waiting:
        name, thing = waiting.pop()
        thing = inspect.unwrap(thing) if callable(thing) else thing
        if isinstance(thing, Mapping):
            waiting += [(f"{name}[{key!r}]", value) for key, value in thing.items()]
            continue
        if isinstance(thing, tuple | list):
            waiting += [(f"{name}[{i}]", value) for i, value in enumerate(thing)]
            continue
        if isinstance(thing, FunctionType | type | ModuleType):
            owner = thing.__name__ if isinstance(thing, ModuleType) else thing.__module__
            if owner.split(".")[0] != package or (source := inspect.getsource(thing)) in seen:
                continue
            seen.add(source)
        elif not callable(thing):
            seen.add(f"{name} = {thing!r}")
        methods = vars(thing).values() if isinstance(thing, type) else [thing]
        for method in (m for m in methods if isinstance(m, FunctionType)):
            known = method.__globals__
            waiting += [(word, known[word]) for word in _names(method.__code__) if word in known]
    return seen


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
