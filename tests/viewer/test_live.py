"""Live views: a local server, and frames that do not change the flow."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
import torch

from fishrl.envs import Flows, Predation, make_env
from fishrl.envs.scene import Frame
from fishrl.programs.live import LiveView
from fishrl.viewer import Drawing, Server, ViewerSettings, start_drawing
from fishrl.viewer.process import HOST, Viewer, find_port
from tests.envs.conftest import SMALL
from tests.viewer.scenes import make_frame, make_scene

FLOWS = {0: "flow 0"}


def find_listeners(port: int) -> set[str]:
    """Return the addresses (hexadecimal) at which a port of this machine listens."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with open(table) as lines:
            for line in list(lines)[1:]:
                address, number = line.split()[1].split(":")
                if int(number, 16) == port and line.split()[3] == "0A":
                    found.add(address)
    return found


def await_listeners(port: int, wanted: set[str]) -> None:
    deadline = time.monotonic() + 300.0
    while find_listeners(port) != wanted and time.monotonic() < deadline:
        time.sleep(0.05)
    assert find_listeners(port) == wanted


def test_server_listens_locally_and_may_end_before_streams() -> None:
    with closing(Server(port=29400)) as server:
        assert server.url == f"rerun+http://127.0.0.1:{server.port}/proxy"
        for port in (server.port, int(server.page.split("?")[0].rsplit(":", 1)[1])):
            await_listeners(port, {"0100007F"})  # 127.0.0.1, lowest byte first
        drawing = start_drawing(make_scene(), flows=FLOWS, url=server.url)
        drawing.draw(0, make_frame(0))
        drawing.stream.flush(timeout_sec=300.0)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((HOST, server.port), timeout=1.0)
    drawing.draw(0, make_frame(1))
    drawing.close()


def test_server_ends_with_a_killed_program() -> None:
    code = "from fishrl.viewer import Server\nprint(Server(port=29450).port, flush=True)\ninput()"
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as program:
        assert program.stdout is not None
        port = int(program.stdout.readline())
        assert find_listeners(port)
        program.kill()
    await_listeners(port, set())


def test_taken_ports_are_skipped() -> None:
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        first = taken.getsockname()[1]
        assert first < find_port(first) < first + 100


def test_viewers_started_at_once_share_no_port(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(Server(port=29550)) as first:
        seemed_free = [first.port]
        monkeypatch.setattr(
            "fishrl.viewer.process.find_port",
            lambda port: seemed_free.pop() if seemed_free else find_port(port),
        )
        with closing(Viewer("--serve-web", port=first.port)) as other:
            assert other.is_running and other.port != first.port


def test_viewer_that_cannot_start_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"rerun does not run on port .* with --no-such"):
        Viewer("--no-such-option", port=29500)


class Shown:
    """A live view of the second of two flows, and its frames."""

    def __init__(self, *, port: int, share: float = 1.0) -> None:
        self.task = Predation(**SMALL, time_limit=2)
        checks = self.task.checks_per_action
        self.env = make_env(
            task=self.task, flows=Flows(num_envs=2, compile=False), frames_per_action=checks
        )
        settings = ViewerSettings(
            live=True, shown_flows=[1], port=port, live_share=share, frames_per_T=5
        )
        self.live = LiveView(settings, num_flows=2)
        self.live.on_begin(self.env)
        self.state = self.env.reset()
        self.frames: list[Frame] = []

    def act(self, num: int = 1) -> None:
        for _ in range(num):
            action = self.state.set("action", torch.ones(2, dtype=torch.int64))
            step, self.state = self.env.step_and_maybe_reset(action)
            self.live.on_step(step)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch, kinematic: None) -> Iterator[Shown]:
    shown = Shown(port=29660)
    monkeypatch.setattr(
        Drawing, "draw", lambda drawing, flow, frame: shown.frames.append(frame) or None
    )
    yield shown
    shown.live.on_close()


def test_episodes_share_one_clock(shown: Shown) -> None:
    shown.act(5)
    times = [frame.time for frame in shown.frames]
    assert times == sorted(set(times))
    assert len(times) == pytest.approx(25, abs=3)
    begins = [frame.time for frame in shown.frames if frame.begins]
    assert len(begins) == 3 and begins[1] == pytest.approx(2.2, abs=0.1)
    assert {"action", "reward", "action_mask"} <= set(shown.frames[0].values)
    shown.live.on_close()
    assert shown.env.base_env.on_frame is None


def test_resting_rows_and_restarts_leave_no_frames(shown: Shown) -> None:
    shown.act()
    num_frames = len(shown.frames)
    shown.env.base_env.is_resting = torch.tensor([False, True])
    shown.act()
    assert len(shown.frames) == num_frames
    shown.env.base_env.is_resting = torch.tensor([False, False])
    shown.live.on_new_episodes()
    shown.state = shown.env.reset()
    shown.act()
    assert shown.frames[num_frames].begins
    times = [frame.time for frame in shown.frames]
    assert times == sorted(times)


def test_live_view_keeps_its_share_of_time(shown: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("fishrl.programs.live.time.monotonic", lambda: clock[0])
    shown.live.on_close()
    shown = Shown(port=29680, share=0.25)
    frames: list[Frame] = []

    def read_slowly(*_: object) -> dict[str, torch.Tensor]:
        clock[0] += 1.0
        return {}

    monkeypatch.setattr(Predation, "read_scene", read_slowly)
    monkeypatch.setattr(Drawing, "draw", lambda drawing, flow, frame: frames.append(frame))
    for _ in range(25):
        clock[0] += 2.0
        shown.act()
    shown.live.on_close()
    # 50 s of flow, and frames of 1 s each take a quarter of the total time
    assert len(frames) == pytest.approx(50.0 / 3.0, abs=2.0)


def test_invalid_settings_are_refused() -> None:
    for flows in ([], [2], [-1], [0, 0]):
        with pytest.raises(ValueError, match="must be some of 0 to 1, each once"):
            ViewerSettings(shown_flows=flows).choose_flows(2, default=1)
    with pytest.raises(ValueError, match="must be 'jpeg' or 'u8'"):
        ViewerSettings(field_format="png")
    with pytest.raises(ValueError, match="did you mean 'speed'"):
        ViewerSettings(field="sped")
