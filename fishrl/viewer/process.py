"""The rerun program as a child process that listens on 127.0.0.1 only.

rerun's own ``serve_grpc``, ``spawn`` and headless viewer listen on every network interface.
"""

import socket
import subprocess
import sys
import time
from typing import Any, Self

from fishrl.children import start_child

HOST = "127.0.0.1"
_PATIENCE_S = 300.0
_MAX_PORT = 65535
_SILENT: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


class Viewer:
    """A running rerun program; ``url`` is the address of its gRPC server.

    Args:
        *options: options of the program, in addition to the port.
        port: where it listens; the next free one if it is taken.

    Raises:
        ValueError: if no port is free, or it does not start.
    """

    def __init__(self, *options: str, port: int) -> None:
        self._options = options
        self.port = find_port(port)
        self.url = f"rerun+http://{HOST}:{self.port}/proxy"
        self._process = start_child(
            "import rerun_cli.__main__ as r, sys; sys.exit(r.main())",
            *("--bind", HOST, "--port", str(self.port), *options),
            **_SILENT,
        )
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline and self.is_running:
            if self._listens():
                return
            time.sleep(0.05)
        self.close()
        raise ValueError(self.explain_failure())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def is_running(self) -> bool:
        """Whether the program is still running."""
        return self._process.poll() is None

    def explain_failure(self) -> str:
        """Return the message for a program that does not start, or ends too early."""
        return (
            f"rerun does not run on port {self.port} with {' '.join(self._options)}: run `python "
            "-m rerun` with these options for its error (without a screen it needs a Vulkan "
            "driver, such as Mesa's lavapipe), or give another port"
        )

    def close(self) -> None:
        """End it, and wait until its port is free."""
        self._process.communicate()  # closes the pipe to it, which ends it
        deadline = time.monotonic() + _PATIENCE_S
        while self._listens() and time.monotonic() < deadline:
            time.sleep(0.05)

    def _listens(self) -> bool:
        try:
            socket.create_connection((HOST, self.port), timeout=0.5).close()
        except OSError:
            return False
        return True


def open_window(*options: str) -> None:
    """Start rerun in a window that outlives this process."""
    subprocess.Popen([sys.executable, "-m", "rerun", *options], start_new_session=True, **_SILENT)


def find_port(first: int) -> int:
    """Return the first free port from ``first`` on; raise ValueError if a hundred are taken."""
    for port in range(first, min(first + 100, _MAX_PORT)):
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((HOST, port))
            except OSError:
                continue
            return port
    raise ValueError(f"port = {first}: it and the hundred after it are taken; choose another")
