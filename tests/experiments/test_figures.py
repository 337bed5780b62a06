"""The pictures of a run: they appear, they are bounded, and bad input is refused with a remedy."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from experiments.figures import learning_curve, run_pictures, trajectories, vorticity
from experiments.recording import Recording

Maker = Callable[..., Recording]
METRICS = """frames,train/return,eval/mean_return,train/success_rate,train/loss_qvalue,note
64,-5.0,,0.0,2.0,warm-up
128,-3.0,-4.0,0.1,nan,
192,2.0,,0.5,1.0,
"""


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    (tmp_path / "metrics.csv").write_text(METRICS)
    return tmp_path


def test_a_run_folder_gets_every_picture(make_recording: Maker, run_dir: Path) -> None:
    recordings = [make_recording(captured=False), make_recording(num_frames=9, lane=3.0)]
    written = run_pictures.write_run_pictures(run_dir, recordings, baselines={"random": 0.1})
    assert [path.name for path in written] == [
        "learning_curve.png", "trajectories.png", "vorticity_sequence.png", "vorticity_last.png",
        "capture.gif",
    ]  # fmt: skip
    assert all(path.stat().st_size > 1000 for path in written)


def test_the_first_capture_is_animated_frame_by_frame(make_recording: Maker, run_dir: Path) -> None:
    recordings = [make_recording(captured=False), make_recording(num_frames=9)]
    run_pictures.write_run_pictures(run_dir, recordings)
    with Image.open(run_dir / "capture.gif") as picture:
        assert picture.n_frames == 9


def test_a_run_without_metrics_gets_all_but_the_learning_curve(
    make_recording: Maker, tmp_path: Path
) -> None:
    written = run_pictures.write_run_pictures(tmp_path, [make_recording(num_frames=5)])
    assert "learning_curve.png" not in {path.name for path in written}


def test_blank_cells_words_and_nan_are_left_out_of_the_curves(run_dir: Path) -> None:
    series = learning_curve.read_metrics(run_dir / "metrics.csv")
    assert series["eval/mean_return"][0].tolist() == [128.0]
    assert series["train/loss_qvalue"][1].tolist() == [2.0, 1.0]
    assert "note" not in series


def test_the_animation_shrinks_until_it_fits(make_recording: Maker, tmp_path: Path) -> None:
    recording = make_recording(num_frames=5)
    vorticity.write_animation(recording, tmp_path / "large.gif")
    limit = (tmp_path / "large.gif").stat().st_size // 2
    vorticity.write_animation(recording, tmp_path / "small.gif", max_bytes=limit)
    assert (tmp_path / "small.gif").stat().st_size <= limit


def test_colours_are_symmetric_about_zero_and_saturate_at_a_round_number(
    make_recording: Maker,
) -> None:
    recording = make_recording()
    limit = vorticity.choose_vorticity_limit(recording)
    mirrored = dataclasses.replace(recording, vorticity=-recording.vorticity)
    assert limit == vorticity.choose_vorticity_limit(mirrored)
    assert limit in (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0)


def test_still_water_has_a_colour_limit_too(make_recording: Maker) -> None:
    recording = make_recording(num_frames=3)
    still = dataclasses.replace(recording, vorticity=torch.zeros_like(recording.vorticity))
    assert vorticity.choose_vorticity_limit(still) == 1.0


def test_the_scene_draws_in_body_lengths(make_recording: Maker) -> None:
    recording = make_recording(num_frames=5)
    figure, scene = vorticity._make_single(recording)
    scene.show(4)
    x, y = scene.path.get_data()
    last = recording.head[-1] / recording.body_length
    assert np.allclose([x[-1], y[-1]], last.numpy())
    assert scene.clock.get_text() == "t = 1.0 T"
    assert figure.axes[0].get_xlabel() == "x / L"


def test_snapshots_are_taken_at_the_nearest_frames(make_recording: Maker) -> None:
    assert vorticity.find_frames(make_recording(), [0.0, 1.1, 4.0]) == [0, 4, 16]


@pytest.mark.parametrize("times", [[], [-1.0], [99.0]])
def test_snapshot_times_outside_the_episode_are_refused(
    make_recording: Maker, tmp_path: Path, times: list[float]
) -> None:
    with pytest.raises(ValueError, match=r"times = .*give at least one, each within 0 and 4.0 T"):
        vorticity.write_snapshots(make_recording(), tmp_path / "x.png", times=times)


def test_a_frame_that_is_not_there_is_refused(make_recording: Maker, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="frame = 17: the recording has 17 frames"):
        vorticity.write_flow(make_recording(), tmp_path / "x.png", frame=17)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"frames_per_second": 0}, "frames_per_second = 0: at least 1"),
        ({"max_bytes": 10}, "max_bytes = 10: .*raise it, or record fewer frames"),
    ],
)
def test_an_animation_that_cannot_be_is_refused(
    make_recording: Maker, tmp_path: Path, arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        vorticity.write_animation(make_recording(num_frames=2), tmp_path / "x.gif", **arguments)


def test_pictures_of_no_recording_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="record at least one episode"):
        run_pictures.write_run_pictures(tmp_path, [])
    with pytest.raises(ValueError, match="record at least one episode"):
        trajectories.write_trajectories([], tmp_path / "x.png")


def test_pictures_into_no_folder_are_refused(make_recording: Maker, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no run folder"):
        run_pictures.write_run_pictures(tmp_path / "nothing", [make_recording()])


def test_trajectories_of_different_domains_are_refused(
    make_recording: Maker, tmp_path: Path
) -> None:
    one = make_recording(num_frames=1)
    other = dataclasses.replace(one, body_length=10.0)
    with pytest.raises(ValueError, match="differ in domain or body length"):
        trajectories.write_trajectories([one, other], tmp_path / "x.png")


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "needs 'frames'"), ("a,b\n1,2\n", "needs 'frames'"), ("frames,b\n1,2\n", "needs one")],
)
def test_metrics_without_a_known_column_are_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        learning_curve.write_learning_curve(tmp_path / "metrics.csv", tmp_path / "x.png")


def test_metrics_that_are_missing_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no metrics at .*metrics.csv"):
        learning_curve.write_learning_curve(tmp_path / "metrics.csv", tmp_path / "x.png")
