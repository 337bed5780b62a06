"""The pictures of a run, chosen by what its scene offers."""

import dataclasses
import gc
import weakref
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import matplotlib as mpl
import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image

from fishrl.envs import Flows, make_env
from fishrl.envs.scene import Curve as SceneCurve
from fishrl.envs.scene import Ending
from fishrl.figure_style import STYLE
from fishrl.programs.figures import learning_curve, run_pictures
from fishrl.programs.figures.learning_curve import Curve, write_learning_curve
from fishrl.programs.figures.run_pictures import (
    record_run,
    write_run_pictures,
    write_trajectories,
)
from fishrl.training.evaluation import fixed_starts
from fishrl.viewer import Recording, ViewerSettings, film
from tests.envs.conftest import keep_straight
from tests.programs.lateral_line.signals import make_task
from tests.viewer import scenes

METRICS = """frames,train/return,eval/mean_return,train/success_rate,train/loss_qvalue
64,-5.0,,0.0,2.0
128,-3.0,-4.0,0.1,
192,2.0,,0.5,1.0
"""


def make_recording(*, num_frames: int = 17, has_succeeded: bool = True) -> Recording:
    frames = [scenes.make_frame(number) for number in range(num_frames)]
    ending = Ending(words="caught" if has_succeeded else "hit a wall", is_success=has_succeeded)
    frames[-1] = dataclasses.replace(frames[-1], ending=ending)
    return Recording(scene=scenes.make_scene(), frames=frames)


def scale_vorticity(recording: Recording, factor: float, name: str = "vorticity") -> Recording:
    """Return a recording with the field times a factor, as a field of that name."""
    frames = [
        dataclasses.replace(f, values={**f.values, name: factor * f.values["vorticity"]})
        for f in recording.frames
    ]
    return dataclasses.replace(recording, frames=frames)


def test_run_pictures_are_written(tmp_path: Path) -> None:
    (tmp_path / "metrics.csv").write_text(METRICS)
    recordings = [make_recording(has_succeeded=False), make_recording(num_frames=9)]
    write_run_pictures(tmp_path, recordings, baselines={"random": 0.1})
    written = {path.name for path in tmp_path.glob("*.[pg]*") if path.stat().st_size > 1000}
    assert written == {
        *("learning_curve.png", "trajectories.png", "vorticity_sequence.png"),
        *("vorticity_last.png", "episode.gif"),
    }
    with Image.open(tmp_path / "episode.gif") as picture:  # the success, frame by frame
        assert 9 < picture.n_frames <= 9 + 15  # and its end is held


def test_all_episodes_of_a_task_without_goal_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinematic: None
) -> None:
    drawn, ended = list[Recording](), list[int]()
    write = lambda folder, recordings, **_: drawn.extend(recordings)  # noqa: E731
    monkeypatch.setattr(run_pictures, "write_run_pictures", write)
    monkeypatch.setattr(run_pictures, "_MAX_PERIODS", 1.0)
    env = make_env(task=make_task(), flows=Flows(num_envs=3, compile=False))
    starts = fixed_starts(env.base_env.task, 4, seed=0)
    given: dict[str, Any] = {"settings": ViewerSettings(), "baselines": {}}
    record_run(tmp_path, env, keep_straight, starts, on_episodes=ended.append, **given)
    assert len(drawn) == sum(ended) == 4 and all(recording.frames for recording in drawn)


def test_paths_show_obstacles_and_endings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures, save = list[Figure](), Figure.savefig

    def note(figure: Figure, path: Path, **options: Any) -> None:
        figures.append(figure)
        save(figure, path, **options)

    monkeypatch.setattr(Figure, "savefig", note)
    square = torch.tensor([(80.0, 40.0), (90.0, 40.0), (90.0, 50.0), (80.0, 50.0)])
    recordings, posts = [make_recording(), make_recording()], [square, square * 0.9]
    for recording, post in zip(recordings, posts, strict=True):
        recording.scene = dataclasses.replace(
            recording.scene,
            marks=(),
            curves=(*recording.scene.curves, SceneCurve(key="post", colour=(9, 9, 9))),
        )
        recording.frames = [
            dataclasses.replace(f, values={**f.values, "post": post}) for f in recording.frames
        ]
    write_trajectories(recordings, tmp_path / "x.png")
    (axes,) = figures[0].axes
    drawn = [patch.get_xy()[:4].tolist() for patch in axes.patches if isinstance(patch, Polygon)]
    assert all((post / 20.0).tolist() in drawn for post in posts)
    legend = axes.get_legend()
    words = " ".join(t.get_text() for t in (legend.get_title(), *legend.get_texts()))
    assert "4.0 T, caught" in words and "food" not in words and "outline: obstacle" in words


def test_nothing_of_trajectories_is_cut_off(tmp_path: Path) -> None:
    """Of a small tank without a goal, with many episodes: the border of the picture is white."""
    recordings = [make_recording() for _ in range(12)]
    for recording in recordings:
        tank = {"width": 140, "height": 40, "marks": (), "areas": ()}
        recording.scene = dataclasses.replace(recording.scene, **tank)
    write_trajectories(recordings, tmp_path / "x.png")
    picture = np.asarray(Image.open(tmp_path / "x.png").convert("L"))
    for border in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
        assert (border > 250).all()


def test_colour_limits_are_symmetric_and_round() -> None:
    recording = make_recording()
    limit = film.choose_limit(recording)
    assert limit == film.choose_limit(scale_vorticity(recording, -1.0))
    assert limit in (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0)
    assert film.choose_limit(scale_vorticity(recording, 0.0)) == 1.0
    scene = recording.scene.choose_field("vorticity", limit=4.2)
    assert film.choose_limit(dataclasses.replace(recording, scene=scene)) == 4.2


def test_flow_axes_are_in_body_lengths() -> None:
    recording = scale_vorticity(make_recording(num_frames=5), 0.1, "speed")
    recording.scene = recording.scene.choose_field("speed")
    figure, flow = film.make_figure(film.fit_colours(recording))
    flow.show(recording.frames)
    assert flow.image.get_clim() == (0.0, film.choose_limit(recording))
    assert figure.axes[1].get_ylabel() == "speed  [L/T]"
    x, y = flow.paths["head"].get_data()
    assert np.allclose([x[-1], y[-1]], recording.stack_bl("head")[-1].numpy())
    assert flow.clock.get_text() == "t = 1.0 T"
    assert figure.axes[0].get_xlabel() == "x / L"


@pytest.mark.parametrize("name", ["discrete_sac", "dqn", "drqn", "sac", "ppo"])
def test_losses_are_drawn(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []

    def note(path: Path, curves: dict[str, list[Curve]], **_: object) -> bool:
        drawn.extend(title for title, curve in curves.items() if curve)
        return True

    monkeypatch.setattr(learning_curve, "draw_curves", note)
    metrics = Path(__file__).parents[2] / "goldens" / f"toy_{name}.csv"
    write_learning_curve(metrics, tmp_path / "x.png")
    assert any("critic loss" in title for title in drawn)
    assert sum("entropy" in title for title in drawn) == (name in {"discrete_sac", "sac", "ppo"})


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "frames,b\n", "frames,b\n1,2\n"])
def test_metrics_without_known_column_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(ValueError, match=r"lacks frames|no rows yet|needs one or more of"):
        write_learning_curve(tmp_path / "metrics.csv", tmp_path / "x.png")


def test_painter_keeps_paths_but_releases_fields() -> None:
    recording = make_recording(num_frames=4)
    painter = film.FramePainter(recording.scene.choose_field("vorticity", limit=5.0), dpi=40.0)
    begin = dataclasses.replace(recording.frames[0], begins=True)
    first, later, again = (painter.paint(f) for f in (begin, recording.frames[3], begin))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, later)
    field = recording.frames[0].values["vorticity"].clone()
    kept = weakref.ref(field)
    painter.paint(dataclasses.replace(begin, values={**begin.values, "vorticity": field}))
    del field
    painter.paint(recording.frames[1])
    gc.collect()
    assert kept() is None


def test_partial_redraw_equals_whole_picture() -> None:
    scene, pictures = scenes.make_scene(), []
    painter, whole = film.FramePainter(scene, dpi=100.0), film.FramePainter(scene, dpi=100.0)
    for artist in whole._changing:
        artist.set_animated(False)
    for frame in map(scenes.make_frame, range(3)):
        frame.values["fish"] += torch.tensor([10.0, -26.0])  # over the words in the corner
        pictures.append(painter.paint(frame))
        whole.paint(frame)
        with mpl.rc_context(STYLE):
            whole._canvas.draw()
        assert np.array_equal(pictures[-1], np.asarray(whole._canvas.buffer_rgba())[..., :3])
    assert not np.array_equal(pictures[0], pictures[-1])


def test_zoomed_picture_follows_the_fish_up_to_the_edges() -> None:
    scene = dataclasses.replace(scenes.make_scene(), zoom=4.0)
    flow = film.FlowAxes(Figure().subplots(), scene)
    size = np.array([scene.width, scene.height]) / scene.body_length / 4.0
    lowest, seen = -0.5 / scene.body_length, []
    for shift in (0.0, -10.0, -1000.0):
        frame = scenes.make_frame(0)
        frame.values["fish"] += torch.tensor([shift, 0.0])
        flow.show([frame])
        (x0, x1), (y0, y1) = flow.axes.get_xlim(), flow.axes.get_ylim()
        assert (x1 - x0, y1 - y0) == pytest.approx(tuple(size))
        seen.append(0.5 * (x0 + x1) * scene.body_length)
    assert seen[0] - seen[1] == pytest.approx(10.0) and x0 == pytest.approx(lowest)


@pytest.mark.parametrize(("name", "speed"), [("x.mp4", 1.5), ("x.gif", 0.02)])
def test_film_lasts_as_long_as_its_speed_says(name: str, speed: float, tmp_path: Path) -> None:
    recording, path = make_recording(num_frames=9), tmp_path / name  # 2 T
    film.write_film(recording, path, seconds_per_T=speed)
    _, seconds = imageio_ffmpeg.count_frames_and_secs(path)
    assert seconds == pytest.approx(2.0 * speed + 1.5, abs=0.4)  # and the last frame held


def test_points_have_colours_of_their_values() -> None:
    painter, frame = film.FramePainter(scenes.make_scene(), dpi=100.0), scenes.make_frame(0)

    def paint(felt: float) -> Any:
        values = {**frame.values, "felt": torch.full((2,), felt)}
        return painter.paint(dataclasses.replace(frame, values=values)).astype(int)

    purple, grass = paint(-1.0), paint(1.0)
    dots = (purple != grass).any(-1)
    assert 20 < dots.sum() < 0.01 * dots.size
    assert grass[dots][:, 1].mean() > grass[dots][:, 2].mean()
    assert purple[dots][:, 2].mean() > purple[dots][:, 1].mean()


def test_film_shows_safe_area() -> None:
    scene, frame = scenes.make_scene(), scenes.make_frame(0)
    shown, plain = (
        film.FramePainter(each, dpi=100.0).paint(frame).astype(int)
        for each in (scene, dataclasses.replace(scene, areas=()))
    )
    border = (shown != plain).any(-1)
    assert 100 < border.sum() < 0.02 * border.size
