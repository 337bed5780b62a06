"""Child processes that end with this one, however it ends."""

import os
import select
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any


def start_child(code: str, *arguments: str, **options: Any) -> subprocess.Popen[bytes]:
    """Run Python code in a process group that is killed when the pipe to its stdin closes.

    The kernel closes that pipe when this process ends, so that even SIGKILL leaves nothing behind.
    The child finds modules where this process does.
    ``options`` are those of ``subprocess.Popen``.
    """
    folders = [*map(str, sys.path), str(Path(__file__).parents[1])]
    start = f"import sys; sys.path[:] = {folders!r}"
    code = f"{start}; import fishrl.children; fishrl.children.end_with_pipe(); {code}"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True, **options)


def make_environment() -> dict[str, str]:
    """Return variables with which a Python child imports from where this process does.

    Nothing is added: ``python -m`` alone would import from its working directory first, which may
    hold the files of others.
    """
    folders = os.pathsep.join(map(os.path.abspath, sys.path))
    return {**os.environ, "PYTHONPATH": folders, "PYTHONSAFEPATH": "1"}


def end_with_pipe() -> None:
    """Kill the process group of this process, in the background, once its stdin is closed."""

    def watch() -> None:
        pipe = select.poll()
        pipe.register(0, 0)  # hang-ups alone: its content is for others
        pipe.poll()
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()
