"""The rerun program as a child process that listens on 127.0.0.1 only.

rerun's own ``serve_grpc``, ``spawn`` and headless viewer listen on every network interface.
"""

import logging
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from typing import Any
from urllib.parse import quote

import psutil

from fishrl.children import make_environment, start_child

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"
_PATIENCE_S = 300.0
_MAX_PORT = 65535
_SILENT: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


class Viewer:
    """A running rerun program; ``url`` is the address of its gRPC server.

    Args:
        *options: command-line options of rerun, in addition to the port.
        port: port of the server; the next free one if it is taken.

    Raises:
        ValueError: if no port is free, or rerun does not start.
    """

    def __init__(self, *options: str, port: int) -> None:
        self._options = options
        while True:
            self.port = find_port(port)
            self.web_port = find_port(self.port + 1)
            self.url = f"rerun+http://{HOST}:{self.port}/proxy"
            if self._start():
                return
            if find_port(self.port) == self.port:
                raise ValueError(self.explain_failure())
            port = self.web_port + 1  # another program took the port meanwhile

    def _start(self) -> bool:
        """Start rerun; return whether it listens."""
        ports = ("--port", str(self.port), "--web-viewer-port", str(self.web_port))
        self._process = start_child(
            "import rerun_cli.__main__ as r, sys; sys.exit(r.main())",
            *("--bind", HOST, *ports, *self._options),
            **_SILENT,
        )
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline and self.is_running:
            if self._listens():
                return True
            time.sleep(0.05)
        self.close()
        return False

    @property
    def is_running(self) -> bool:
        """Whether the program is still running."""
        return self._process.poll() is None

    def explain_failure(self) -> str:
        """Return the message of the error if rerun does not start or ends early."""
        return (
            f"rerun does not run on port {self.port} with {' '.join(self._options)}: run `python "
            "-m rerun` with these options for its error (without a screen it needs a Vulkan "
            "driver, such as Mesa's lavapipe), or give another port"
        )

    def close(self) -> None:
        """End rerun and wait until its port is free."""
        has_port = self._listens()
        self._process.communicate()  # rerun ends when its standard input is closed
        deadline = time.monotonic() + _PATIENCE_S
        while has_port and find_port(self.port) != self.port and time.monotonic() < deadline:
            time.sleep(0.05)

    def _listens(self) -> bool:
        """Return whether rerun, and not another program, listens on the port."""
        with suppress(psutil.Error):  # it has ended
            for program in psutil.Process(self._process.pid).children():
                for one in program.net_connections("tcp"):
                    if one.status == psutil.CONN_LISTEN and one.laddr.port == self.port:
                        return True
        return False


class Server(Viewer):
    """Server that passes a stream to windows and, at ``page``, browsers on this machine.

    It opens a window if there is a screen. It keeps the newest 512 MB of frames for viewers that
    join later. Closing a window does not end the server, and an open window keeps its frames after
    the server has ended. Its argument and errors are those of ``Viewer``.
    """

    def __init__(self, *, port: int = 9876) -> None:
        super().__init__("--serve-web", "--server-memory-limit", "512MB", port=port)
        self.page = f"http://{HOST}:{self.web_port}?url={quote(self.url, safe='')}"
        if has_screen():
            open_window("--bind", HOST, "--port", "auto", "--connect", self.url)
        words = "live on this machine: a window by `python -m rerun --connect %s`, a browser by %s"
        logger.info(words, self.url, self.page)


def has_screen() -> bool:
    """Return whether this process can open a window."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_window(*options: str) -> None:
    """Start rerun in a window that stays open after this process has ended."""
    command, env = [sys.executable, "-m", "rerun", *options], make_environment()
    subprocess.Popen(command, env=env, start_new_session=True, **_SILENT)


def find_port(first: int) -> int:
    """Return the first free port of a hundred from ``first``; raise ValueError if none is free."""
    for port in range(first, min(first + 100, _MAX_PORT)):
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((HOST, port))
            except OSError:
                continue
            return port
    raise ValueError(f"port = {first}: this port and the next 99 are taken; choose another")
