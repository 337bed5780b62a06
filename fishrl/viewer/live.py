"""A viewer's server on this machine, to look at flows while they run."""

import os
import sys

from fishrl.viewer.process import HOST, Viewer, find_port, start_rerun


class Server(Viewer):
    """Takes in a stream and hands it to windows and browsers on this machine.

    It keeps what fits into its memory, the newest, for those that join late. Closing a window does
    not end it, its end does not disturb who draws, and an open window keeps what it has got.

    Args:
        port: where streams arrive; the next free one if it is taken.
        memory: most that it keeps.
        opens_window: open a window; by default where there is a screen.

    Attributes:
        page: for browsers.

    Raises:
        ValueError: if no port is free, or it does not start.
    """

    def __init__(
        self, *, port: int = 9876, memory: str = "512MB", opens_window: bool | None = None
    ) -> None:
        port = find_port(port)
        web_port = find_port(port + 1)
        options = ("--serve-web", "--web-viewer-port", str(web_port))
        super().__init__(*options, "--server-memory-limit", memory, port=port)
        escaped = self.url.replace("+", "%2B").replace(":", "%3A").replace("/", "%2F")
        self.page = f"http://{HOST}:{web_port}?url={escaped}"
        if has_screen() if opens_window is None else opens_window:
            start_rerun("--bind", HOST, "--port", "auto", "--connect", self.url)


def has_screen() -> bool:
    """Return whether a window could be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
