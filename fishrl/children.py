"""Child processes that end with this one, however it ends."""

import os
import select
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from fishrl.forks import leave_to_parent

#: Whether this system has process groups; Windows has none.
CAN_START = hasattr(os, "killpg")
_PARENT_CHECK_MS = 1000


def start_child(code: str, *arguments: str, **options: Any) -> subprocess.Popen[bytes]:
    """Run Python code in a process group that is killed when the pipe to its stdin closes.

    The kernel closes that pipe when this process ends, so that even SIGKILL leaves nothing behind.
    Processes forked from this one do not keep it open; the child also watches this process itself.
    The child finds modules where this process does.
    ``options`` are passed to ``subprocess.Popen``.

    Raises:
        ValueError: on a system without process groups.
    """
    if not CAN_START:
        raise ValueError("child processes need Linux or macOS; on Windows use its Linux (WSL)")
    folders = [*map(str, sys.path), str(Path(__file__).parents[1])]
    start = f"import sys; sys.path[:] = {folders!r}"
    code = f"{start}; import fishrl.children; fishrl.children.end_with_pipe({os.getpid()}); {code}"
    command = [sys.executable, "-c", code, *arguments]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True, **options)
    for pipe in (child.stdin, child.stdout):
        if pipe is not None:
            leave_to_parent(pipe)
    return child


def make_environment() -> dict[str, str]:
    """Return variables with which a Python child imports from where this process does.

    Nothing is added: ``python -m`` alone would import from its working directory first, which may
    hold the files of others.
    """
    folders = os.pathsep.join(map(os.path.abspath, sys.path))
    return {**os.environ, "PYTHONPATH": folders, "PYTHONSAFEPATH": "1"}


def end_with_pipe(parent: int) -> None:
    """Kill this process group, in the background, once stdin is closed or the parent has ended."""

    def watch() -> None:
        pipe = select.poll()
        pipe.register(0, 0)  # hang-ups alone: its content is for others
        while not pipe.poll(_PARENT_CHECK_MS) and os.getppid() == parent:
            pass
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()
