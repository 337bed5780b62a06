"""The server of live views on this machine."""

import logging
import os
import sys

from fishrl.viewer.process import HOST, Viewer, find_port, open_window

logger = logging.getLogger(__name__)


class Server(Viewer):
    """Takes in a stream and passes it to windows and, at ``page``, browsers on this machine.

    It keeps the newest frames that fit into 512 MB, for those that join late. Closing a window
    does not end it, and an open window keeps its frames when the server ends.

    Args:
        port: where streams arrive; the next free one if it is taken.
        opens_window: open a window; by default where there is a screen.

    Raises:
        ValueError: if no port is free, or it does not start.
    """

    def __init__(self, *, port: int = 9876, opens_window: bool | None = None) -> None:
        port = find_port(port)
        web_port = find_port(port + 1)
        options = ("--serve-web", "--web-viewer-port", str(web_port))
        super().__init__(*options, "--server-memory-limit", "512MB", port=port)
        escaped = self.url.replace("+", "%2B").replace(":", "%3A").replace("/", "%2F")
        self.page = f"http://{HOST}:{web_port}?url={escaped}"
        if has_screen() if opens_window is None else opens_window:
            open_window("--bind", HOST, "--port", "auto", "--connect", self.url)
        words = "live on this machine: a window by `python -m rerun --connect %s`, a browser by %s"
        logger.info(words, self.url, self.page)


def has_screen() -> bool:
    """Return whether a window could be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
