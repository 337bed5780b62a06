"""The rerun file of an episode: it verifies, holds what it should, and errors say what to do."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from experiments import view
from experiments.recording import Recording
from fishrl import viewer

ENTITIES = {
    "/about", "/episode/action", "/episode/distance", "/episode/reward", "/world/capture_radius",
    "/world/fish", "/world/food", "/world/trajectory", "/world/vorticity",
}  # fmt: skip
Maker = Callable[..., Recording]


def run_rerun(*arguments: str) -> str:
    command = [sys.executable, "-m", "rerun", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("field_format", list(viewer.FieldFormat))
def test_the_file_verifies_and_holds_every_entity_on_one_timeline(
    make_recording: Maker, tmp_path: Path, field_format: viewer.FieldFormat
) -> None:
    path = tmp_path / "capture.rrd"
    viewer.write_recording(
        make_recording(num_frames=3), path, vorticity_limit=10.0, field_format=field_format
    )
    run_rerun("rrd", "verify", str(path))
    shown = run_rerun("rrd", "print", "-vvv", str(path))
    assert {entity for entity in ENTITIES if entity in shown} == ENTITIES
    assert viewer.TIMELINE in shown


def test_node_coordinates_are_flipped_to_pixel_centres_of_the_picture(
    make_recording: Maker,
) -> None:
    recording = make_recording(num_frames=1)
    height = recording.domain[1]
    x, y = recording.head[0].tolist()
    placed = viewer._place(recording.head[0], height)
    assert placed.tolist() == pytest.approx([x + 0.5, height - 0.5 - y])


def test_writing_the_same_episode_twice_replaces_the_file(
    make_recording: Maker, tmp_path: Path
) -> None:
    path = tmp_path / "capture.rrd"
    for _ in range(2):
        viewer.write_recording(make_recording(num_frames=2), path, vorticity_limit=10.0)
    run_rerun("rrd", "verify", str(path))


def test_an_unknown_field_format_names_those_allowed(make_recording: Maker, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"field_format = 'png': allowed are \['jpeg', 'u8'\]"):
        viewer.write_recording(
            make_recording(), tmp_path / "x.rrd", vorticity_limit=1.0, field_format="png"
        )


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_vorticity_limit_that_is_not_positive_is_refused(
    make_recording: Maker, tmp_path: Path, limit: float
) -> None:
    with pytest.raises(ValueError, match=r"vorticity_limit = .*: must be positive"):
        viewer.write_recording(make_recording(), tmp_path / "x.rrd", vorticity_limit=limit)


def test_a_missing_folder_is_named(make_recording: Maker, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no folder .*nowhere: make it first"):
        viewer.write_recording(make_recording(), tmp_path / "nowhere/x.rrd", vorticity_limit=1.0)


def test_without_rerun_the_error_says_what_to_install(
    make_recording: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ImportError, match="pip install 'rerun-sdk"):
        viewer.write_recording(make_recording(), tmp_path / "x.rrd", vorticity_limit=1.0)


def test_view_opens_the_capture_of_a_run_folder(
    make_recording: Maker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "capture.rrd"
    viewer.write_recording(make_recording(num_frames=1), path, vorticity_limit=10.0)
    opened: list[list[str]] = []
    monkeypatch.setattr(viewer.subprocess, "run", lambda command, check: opened.append(command))
    assert view.main([str(tmp_path)]) == 0
    assert opened == [[sys.executable, "-m", "rerun", str(path)]]


@pytest.mark.parametrize("extra", [[], ["--screenshot", "picture.png"]])
def test_view_of_a_missing_file_says_so_and_fails(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, extra: list[str]
) -> None:
    assert view.main([str(tmp_path / "nothing.rrd"), *extra]) == 1
    assert "no .rrd file at" in capsys.readouterr().err
