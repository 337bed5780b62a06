"""Recordings in files, screenshots, and errors."""

import subprocess
import sys
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import pytest

from fishrl.viewer import files as files_module
from fishrl.viewer import open_recording, start_drawing, write_screenshot
from fishrl.viewer.drawing import TIMELINE
from fishrl.viewer.process import Viewer
from fishrl.viewer.settings import FieldFormat
from tests.viewer.pictures import check_views, needs_vulkan, photograph_views
from tests.viewer.scenes import make_frame, make_scene

FLOWS = {0: "flow 0: slow", 3: "flow 3: fast"}
ENTITIES = {
    *(f"/flow_{i}/world/{name}" for i in FLOWS for name in ("vorticity", "fish", "midline")),
    *(f"/flow_{i}/plots/{name}" for i in FLOWS for name in ("reward/0", "power_x_T/0")),
    "/flow_0/world/food", "/flow_0/world/food_reach", "/flow_0/world/neuromasts",
    "/flow_0/world/danger_area", "/flow_0/world/trajectory_head", "/flow_0/about",
    "/flow_0/plots/class_probabilities/1", "/flow_0/plots/angle/0",
    "/legend/vorticity/ramp", "/legend/neuromasts/ticks",
}  # fmt: skip


@pytest.fixture
def unstarted(monkeypatch: pytest.MonkeyPatch) -> type[Viewer]:
    """Return a viewer without a process, and skip all waiting times."""

    class Unstarted(Viewer):
        is_running = False

        def __init__(self, *options: str, port: int) -> None:
            self._options, self.port, self.url = options, port, "nowhere"

        def close(self) -> None:
            """Do nothing."""

    monkeypatch.setattr(files_module, "Viewer", Unstarted)
    monkeypatch.setattr(files_module, "_GREETING_S", 0.0)
    monkeypatch.setattr(files_module.time, "sleep", lambda seconds: None)
    return Unstarted


LINE = SimpleNamespace(name=TIMELINE, start=0, end=2_000_000_000)
STATE = SimpleNamespace(loading=[], recordings=[SimpleNamespace(timelines=[LINE])])


def write(path: Path, *, num_frames: int = 3, field_format: FieldFormat = "jpeg") -> None:
    drawing = start_drawing(make_scene(), flows=FLOWS, save=path, field_format=field_format)
    with closing(drawing):
        for number in range(num_frames):
            for flow in FLOWS:
                drawing.draw(flow, make_frame(number))


def run_rerun(*arguments: str) -> str:
    command = [sys.executable, "-m", "rerun", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_files_verify_and_hold_every_entity_in_few_chunks(tmp_path: Path) -> None:
    paths = []
    for field_format in get_args(FieldFormat):
        paths.append(tmp_path / f"{field_format}.rrd")
        write(paths[-1], num_frames=41, field_format=field_format)
        size = paths[-1].stat().st_size
        write(paths[-1], num_frames=3, field_format=field_format)  # replaces the file
        # one chunk per frame and entity would take another 2 kB for each of 2 x 18 entities
        image = 7200 if field_format == "u8" else 0
        assert 0 < (size - paths[-1].stat().st_size) / 38 < 2 * (18 * 1000 + image)
    run_rerun("rrd", "verify", *map(str, paths))
    shown = run_rerun("rrd", "print", "-vvv", str(paths[0]))
    assert {entity for entity in ENTITIES if entity in shown} == ENTITIES


@needs_vulkan
@pytest.mark.parametrize("field_format", ["jpeg", pytest.param("u8", marks=pytest.mark.slow)])
def test_every_view_draws(tmp_path: Path, field_format: FieldFormat) -> None:
    path = tmp_path / "flows.rrd"
    write(path, num_frames=9, field_format=field_format)
    pictures = photograph_views(path, time_T=1.5)
    check_views(pictures, make_scene(), title="flow 0: slow", least=0.02)


def test_busy_viewer_is_retried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unstarted: type[Viewer]
) -> None:
    times: list[float] = []
    client = SimpleNamespace()
    answers = {"connect": client, "open": None, "get_state": STATE, "set_time": None}
    answers["take_screenshot"] = b"picture"
    failures = dict.fromkeys(answers, 2)

    def answer(name: str) -> Any:
        def call(*_: Any, duration: float = -1.0, **__: Any) -> Any:
            failures[name] -= 1
            if failures[name] >= 0:
                raise (ConnectionError if failures[name] else TimeoutError)("no answer in time")
            times.append(duration)
            return answers[name]

        return call

    for name in answers:
        setattr(client, name, answer(name))
    monkeypatch.setattr("rerun.experimental.ViewerClient", client)
    monkeypatch.setattr(unstarted, "is_running", True)
    write(tmp_path / "flows.rrd", num_frames=1)
    write_screenshot(tmp_path / "flows.rrd", tmp_path / "x.png")
    assert (tmp_path / "x.png").read_bytes() == b"picture"
    assert max(times) == 1.0  # the middle


@needs_vulkan
def test_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flows.rrd"
    write(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"flows\.rrd has no timeline"):
        write_screenshot(path, tmp_path / "x.png")


def test_recording_of_run_folder_opens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "episode.rrd", num_frames=1)
    opened: list[list[str]] = []
    status = [0, 1]

    def run(command: list[str], check: bool, env: dict[str, str]) -> Any:
        opened.append(command)
        return SimpleNamespace(returncode=status.pop(0))

    monkeypatch.setattr(files_module.subprocess, "run", run)
    open_recording(tmp_path)
    (command,) = opened
    assert command[-1] == str(tmp_path / "episode.rrd")
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    with pytest.raises(ValueError, match="ended with status 1: its window needs a screen"):
        open_recording(tmp_path)
