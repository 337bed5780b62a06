"""The program that shows flows, and live views of trainings, on kinematic fish."""

import socket
import tempfile
from pathlib import Path

import imageio_ffmpeg
import pytest
from PIL import Image

from fishrl.programs import stored_task, view
from fishrl.programs.train_settings import TRAINING
from fishrl.training.run_folder import write_yaml
from fishrl.viewer import Server
from fishrl.viewer.process import HOST
from tests.experiments.gait.tasks import OVERRIDES
from tests.viewer.test_files import run_rerun

pytestmark = pytest.mark.usefixtures("kinematic")

GAIT = ["preset=gait_small", *OVERRIDES, "flows.compile=false"]


def test_chosen_flows_are_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.rrd"
    arguments = ["policy=pid", "episodes=4", "shown_flows=[1,3]", "periods=1", f"save={path}"]
    view.main([*GAIT, "recognition=oracle", *arguments])
    assert capsys.readouterr().out == f"written: {path}, {path.stat().st_size / 1e6:.2f} MB\n"
    shown = run_rerun("rrd", "print", "-v", str(path))
    assert "/flow_1/plots/class_probabilities/2" in shown
    assert "/flow_3/world/neuromasts" in shown
    assert "/flow_0/" not in shown


@pytest.mark.parametrize("ending", ["mp4", "gif", "png"])
def test_flow_is_filmed(ending: str, tmp_path: Path) -> None:
    film = f"{tmp_path}/x.{ending}"
    words = ["policy=pursuit", "flows.compile=false", "periods=1", "zoom=2", "seconds_per_T=1"]
    view.main([*words, f"save={film}"])
    if ending == "png":
        assert Image.open(film).width > 100
    else:
        num_frames, _ = imageio_ffmpeg.count_frames_and_secs(film)
        assert num_frames > 15  # 20 in a second, as far as checks allow


def test_typical_start_of_a_policy_is_shown_unless_others_are_asked_for() -> None:
    typical = stored_task.read_result("zoo/gait_bend")["view"]
    for words, expected in (
        (["periods=3"], (typical["episodes"], tuple(typical["shown_flows"]), None)),
        (["seed=1"], (1, None, None)),
        (["episodes=2"], (2, None, None)),
        (["task.reynolds=400"], (1, None, None)),
    ):
        read = view.main.read(["policy=zoo/gait_bend", *words])
        assert (read.episodes, read.shown_flows, read.save) == expected


def test_path_alone_opens_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(view, "has_screen", lambda: True)
    monkeypatch.setattr(view, "open_recording", opened.append)
    monkeypatch.chdir(tmp_path)
    Path("it's one.rrd").touch()
    view.main(["it's one.rrd"])
    assert opened == [Path("it's one.rrd")]


def test_live_view_stays_until_interrupt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = view.main.read([*GAIT, "policy=pid", "live=true", "periods=1", "port=29600"])
    servers: list[Server] = []
    waited: list[bool] = []

    def serve(*, port: int) -> Server:
        servers.append(Server(port=port))
        return servers[-1]

    def wait() -> None:
        socket.create_connection((HOST, servers[0].port), timeout=2.0).close()
        waited.append(True)

    monkeypatch.setattr(view, "Server", serve)
    monkeypatch.setattr(view, "wait_for_interrupt", wait)
    view.main.run(config)
    assert waited == [True]
    assert ".rrd" not in capsys.readouterr().out  # the file goes with the program


def test_recording_stays_if_viewer_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "__EGL_VENDOR_LIBRARY_FILENAMES"):
        monkeypatch.setenv(name, "nowhere")
    words = [*GAIT, "policy=pid", "periods=1", f"screenshot={tmp_path}/x.png"]
    with pytest.raises(SystemExit, match="rerun does not run") as failed:
        view.main(words)
    kept = Path(str(failed.value).partition("kept: ")[2])
    assert kept.is_relative_to(tmp_path)
    assert "/flow_0/" in run_rerun("rrd", "print", "-v", str(kept))
    assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.rrd"], r"error: no \.rrd file at nowhere\.rrd"),
        (
            [*GAIT, "policy=pid", "shown_flows=[1]", "save=x.rrd"],
            r"error: shown_flows = \[1\]: must be some",
        ),
        (
            ["policy=pid", "save=x.avi"],
            r"save = .x\.avi.: must be a file that ends in one of \.rrd",
        ),
        (["policy=pid", "screenshot=y.jpg"], r"screenshot = .y\.jpg.: must be .* \.png"),
        (["policy=pid", "zoom=2", "save=x.rrd"], "error: zoom, seconds_per_T: of a film"),
        (["policy=pid", "time=3", "save=x.png"], r"error: time = 3: of screenshot.* periods=3"),
        (
            ["x.rrd", "field=speed", "episodes=2", "periods=3", "task.reynolds=400", "seed=1"],
            r"error: field, task, seed, episodes, periods: a recording is only opened",
        ),
    ],
)
def test_errors_are_one_line(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=said) as error:
        view.main(arguments)
    assert "\n" not in str(error.value)


def test_resumed_run_is_live_only_on_request(tmp_path: Path) -> None:
    config = TRAINING.read(["live=true"])
    write_yaml(tmp_path / "config.yaml", config.to_config())
    assert not TRAINING.read([f"resume='{tmp_path}'"]).live
    assert TRAINING.read([f"resume='{tmp_path}'", "live=true"]).live
