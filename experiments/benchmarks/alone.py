"""What is measured beside the contests runs in a process of its own, as everything does."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def run_alone(function: Callable[..., T], **arguments: object) -> T:
    """Run a function at the top of a module in a new process, and return what it returns."""
    # spawned, not forked: a fork of a process with threads (torch has some) may hang
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=context) as pool:
        return pool.submit(function, **arguments).result()
