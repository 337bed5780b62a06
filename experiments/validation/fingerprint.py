"""What a job's result depends on, as one short word: unchanged jobs need not run again."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping
from types import CodeType, FunctionType
from typing import Any

import torch

from experiments.validation.case import Job
from fishrl.physics.cache_key import hash_sources, make_key


def fingerprint(job: Job) -> str:
    """Return a word that changes when the job's result may.

    It covers the arguments, the function with all it calls and the constants it reads in this
    package (not the rest of its file: a new tolerance or figure runs nothing again), every source
    file of ``fishrl.physics`` and the version of torch. Imports inside functions are not seen.
    """
    name = f"{job.function.__module__}.{job.function.__qualname__}"
    arguments = json.dumps(job.arguments, sort_keys=True)
    sources: set[str] = set()
    _read_sources(name, job.function, sources)
    return make_key(name, arguments, sorted(sources), hash_sources(), torch.__version__)


def _read_sources(name: str, thing: Any, seen: set[str]) -> None:
    """Add the value of a constant, or the source of a function or type and of all it uses."""
    if isinstance(thing, Mapping | tuple | list):
        items = thing.items() if isinstance(thing, Mapping) else enumerate(thing)
        for key, value in items:
            _read_sources(f"{name}[{key!r}]", value, seen)
    elif isinstance(thing, FunctionType | type):
        own = thing.__module__.startswith(("experiments.", "tests."))
        if not own or (source := inspect.getsource(thing)) in seen:
            return
        seen.add(source)
        if isinstance(thing, FunctionType):
            for word in _find_names(thing.__code__):
                if word in thing.__globals__:
                    _read_sources(word, thing.__globals__[word], seen)
    elif not callable(thing) and not inspect.ismodule(thing):
        seen.add(f"{name} = {thing!r}")


def _find_names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _find_names(constant)
