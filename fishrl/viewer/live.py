"""Flows streamed to a viewer on this machine while they train or are evaluated."""

import logging
import os
import sys
import time
from dataclasses import replace

from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.scene import Frame
from fishrl.viewer.files import start_drawing
from fishrl.viewer.process import HOST, Viewer, find_port, open_window
from fishrl.viewer.recording import Recorder, make_scene, name_flows
from fishrl.viewer.settings import ViewerSettings

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


class LiveView:
    """Streams some flows of an env while they run; episodes follow each other on one clock.

    It reads the flows and changes nothing.

    Args:
        env: made with ``frames_per_action=task.checks_per_action``; its ``on_frame`` is set.
        settings: which flows, how often and how; ``live_share`` limits the wall time that it takes:
            frames that would cost more are left out.

    Raises:
        ValueError: for flows that the env does not have, or if the server does not start.
    """

    def __init__(self, env: TransformedEnv, settings: ViewerSettings) -> None:
        self._base: FlowEnv = env.base_env
        self._flows = settings.choose_flows(env.batch_size[0], default=1)
        scene = make_scene(env, field=settings.field, field_limit=settings.field_limit)
        self._recorder = Recorder(
            self._base, scene, frames_per_T=settings.frames_per_T, give=self._draw
        )
        self._server = Server(port=settings.port)
        self._drawing = start_drawing(
            scene,
            flows=name_flows(self._base.task, self._flows),
            url=self._server.url,
            field_format=settings.field_format,
        )
        self._offset_T, self._last_T = (dict.fromkeys(self._flows, 0.0) for _ in range(2))
        self._share, self._spent, self._began = settings.live_share, 0.0, time.monotonic()
        self.restart()
        self._base.on_frame = self._keep

    def restart(self) -> None:
        """Expect new episodes in all flows."""
        self._recorder.begin(self._flows)

    def _keep(self, base: FlowEnv) -> None:
        start = time.monotonic()
        if self._recorder.is_due() and self._spent <= self._share * (start - self._began):
            is_moving = base.is_moving.tolist()
            self._recorder.keep([flow for flow in self._flows if is_moving[flow]])
            self._spent += time.monotonic() - start

    def settle(self, step: TensorDictBase) -> None:
        """Show the frames of a decision that is over; ``step`` ``[B]`` as the env returns it."""
        start = time.monotonic()
        self._recorder.settle(step, self._flows)
        is_done = step["next", "done"].flatten().tolist()
        self._recorder.begin([flow for flow in self._flows if is_done[flow]])
        self._spent += time.monotonic() - start

    def _draw(self, flow: int, frame: Frame) -> None:
        if frame.begins:
            self._offset_T[flow] += self._last_T[flow]
        self._last_T[flow] = frame.time
        self._drawing.draw(flow, replace(frame, time=self._offset_T[flow] + frame.time))

    def close(self) -> None:
        """End the stream and the server; an open window keeps its frames."""
        self._base.on_frame = None
        self._drawing.close()
        self._server.close()


def has_screen() -> bool:
    """Return whether a window could be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
