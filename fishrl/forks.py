"""Files that processes forked from this one leave to it."""

import os
from typing import IO, Any
from weakref import WeakSet

_left: WeakSet[IO[Any]] = WeakSet()


def leave_to_parent(file: IO[Any]) -> None:
    """Replace an open file by nothing in processes that are forked from this one."""
    _left.add(file)


def _let_go() -> None:
    nothing = os.open(os.devnull, os.O_RDWR)
    for file in _left:
        if not file.closed:
            os.dup2(nothing, file.fileno(), inheritable=False)
    os.close(nothing)


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_let_go)
