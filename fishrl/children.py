"""Child processes that end with this one, however it ends."""

import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def start_child(
    code: str, *arguments: str, env: Mapping[str, str] | None = None, **options: Any
) -> subprocess.Popen[bytes]:
    """Run Python code in a process group that is killed when the pipe to its stdin closes.

    The kernel closes that pipe when this process ends, so that even SIGKILL leaves nothing behind.

    Args:
        code: Python code.
        *arguments: its ``sys.argv[1:]``.
        env: added to the environment.
        **options: of ``subprocess.Popen``.
    """
    root = str(Path(__file__).parents[1])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"import fishrl.children as c; c.end_with_pipe(); {code}",
            *arguments,
        ],
        stdin=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path, **(env or {})},
        start_new_session=True,
        **options,
    )


def end_with_pipe() -> None:
    """Kill the process group of this process, in the background, once its stdin is closed."""

    def watch() -> None:
        pipe = select.poll()
        pipe.register(0, 0)  # hang-ups alone: its content is for others
        pipe.poll()
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()
