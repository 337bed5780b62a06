"""The live view of a training or an evaluation."""

import time
from dataclasses import replace

from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.scene import Frame
from fishrl.training import Callback
from fishrl.viewer import Drawing, Server, ViewerSettings, make_env_scene, name_flows, start_drawing
from fishrl.viewer.recording import Recorder


class LiveView(Callback):
    """Streams some of ``num_flows`` flows to a viewer on this machine if ``live`` is set.

    Episodes follow each other on one clock. It reads the flows and changes nothing.

    Args:
        settings: which flows, how often and how; ``live_share`` limits the wall time that it takes:
            frames that would cost more are left out.
        num_flows: flows of the env, which is made with ``frames_per_action=checks_per_action``.

    Raises:
        ValueError: for flows that the env does not have, or if the server does not start.
    """

    _server: Server | None = None  # of a view that is open

    def __init__(self, settings: ViewerSettings, *, num_flows: int) -> None:
        self.settings = settings
        self._flows = settings.choose_flows(num_flows, default=1) if settings.live else []

    def on_begin(self, env: TransformedEnv) -> None:
        """Start the live view."""
        settings = self.settings
        if not settings.live:
            return
        self._base: FlowEnv = env.base_env
        scene = make_env_scene(env, settings)
        self._recorder = Recorder(
            self._base, scene, frames_per_T=settings.frames_per_T, give=self._draw
        )
        self._server = Server(port=settings.port)
        self._drawing: Drawing = start_drawing(
            scene,
            flows=name_flows(self._base.task, self._flows),
            url=self._server.url,
            field_format=settings.field_format,
        )
        self._offset_T, self._last_T = (dict.fromkeys(self._flows, 0.0) for _ in range(2))
        self._spent, self._began = 0.0, time.monotonic()
        self.on_new_episodes()
        self._base.on_frame = self._keep

    def on_new_episodes(self) -> None:
        """Expect new episodes in all flows."""
        if self._server is not None:
            self._recorder.begin(self._flows)

    def _keep(self, base: FlowEnv) -> None:
        start, share = time.monotonic(), self.settings.live_share
        if self._recorder.is_due() and self._spent <= share * (start - self._began):
            is_moving = base.is_moving.tolist()
            self._recorder.keep([flow for flow in self._flows if is_moving[flow]])
            self._spent += time.monotonic() - start

    def on_step(self, step: TensorDictBase) -> None:
        """Show the frames of a finished decision; ``step`` ``[B]`` as the env returns it."""
        if self._server is None:
            return
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

    def on_close(self) -> None:
        """End the stream and the server; an open window keeps its frames."""
        if self._server is not None:
            self._base.on_frame = None
            self._drawing.close()
            self._server.close()
            self._server = None
