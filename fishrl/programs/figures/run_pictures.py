"""The pictures of a run: episodes of its policy and its learning curve."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from fishrl.envs.episodes import Policy, count_decisions
from fishrl.envs.scene import Frame
from fishrl.programs.figures.learning_curve import write_learning_curve
from fishrl.programs.figures.style import COLOURS, panels
from fishrl.viewer import (
    Recording,
    ViewerSettings,
    make_scene,
    name_flows,
    record_episodes,
    start_drawing,
)
from fishrl.viewer.film import FOOD, label_axes, write_film, write_flow, write_snapshots

#: Number of flows kept in ``capture.rrd``.
_MAX_FLOWS = 3
#: Recorded duration of episodes of tasks without a goal, T.
_MAX_PERIODS = 20.0


def record_run(
    folder: Path,
    env: TransformedEnv,
    policy: Policy,
    starts: TensorDictBase,
    *,
    settings: ViewerSettings,
    baselines: Mapping[str, float],
    on_episodes: Callable[[int], None],
) -> None:
    """Record the policy of a run from ``starts`` ``[E]`` and draw its pictures into its folder.

    ``on_episodes`` is called with the number of episodes that have just ended.
    """
    task = env.base_env.task
    scene = make_scene(env, field=settings.field, field_limit=settings.field_limit)
    flows, max_decisions = list(range(min(_MAX_FLOWS, len(starts)))), None
    if scene.goal is None:
        starts, max_decisions = starts[flows], count_decisions(task, _MAX_PERIODS)
    recordings = [Recording(scene=scene) for _ in range(len(starts))]

    drawing = start_drawing(
        scene,
        flows=name_flows(task, flows, starts),
        save=folder / "capture.rrd",
        field_format=settings.field_format,
    )
    with closing(drawing):

        def give(start: int, frame: Frame) -> None:
            if scene.goal is not None:
                recordings[start].frames.append(frame)
            if start in flows:
                drawing.draw(start, frame)

        episodes = record_episodes(
            env,
            policy,
            starts,
            scene=scene,
            give=give,
            frames_per_T=settings.frames_per_T,
            max_decisions=max_decisions,
            on_episodes=on_episodes,
        )
    for recording, has_succeeded in zip(recordings, episodes.succeeded.tolist(), strict=True):
        recording.has_succeeded = has_succeeded
    write_run_pictures(folder, recordings, baselines=baselines)


def write_run_pictures(
    folder: Path, recordings: Sequence[Recording], *, baselines: Mapping[str, float]
) -> None:
    """Write the learning curve and, if the task has a goal, pictures of the episodes.

    All ``recordings`` go into ``trajectories.png``; the first one that succeeded (else the first
    one) into the flow pictures and the animation.
    """
    if (folder / "metrics.csv").is_file():
        curve = folder / "learning_curve.png"
        write_learning_curve(folder / "metrics.csv", curve, baselines=baselines)
    if recordings[0].scene.goal is not None:
        shown = next((r for r in recordings if r.has_succeeded), recordings[0])
        write_trajectories(recordings, folder / "trajectories.png")
        field = shown.scene.field.key
        write_snapshots(shown, folder / f"{field}_sequence.png")
        write_flow(shown, folder / f"{field}_last.png")
        write_film(shown, folder / "capture.gif")


def write_trajectories(recordings: Sequence[Recording], path: Path) -> None:
    """Draw head paths from several starts, the goal's path and where it was reached."""
    scene = recordings[0].scene
    x, y = scene.width / scene.body_length, scene.height / scene.body_length
    with panels(path, size=(9, 0.5 + 6.6 * y / x), has_grid=False) as [[axes]]:
        for number, recording in enumerate(recordings):
            _draw_trajectory(axes, recording, COLOURS[number % len(COLOURS)])
        axes.set(xlim=(0, x), ylim=(0, y), aspect="equal")
        label_axes(axes)
        axes.legend(
            loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, fontsize=9,
            title="filled: at the start\nline: head · dots: food\ncircle: capture radius",
            title_fontsize=8.5, alignment="left", labelspacing=0.55,
        )  # fmt: skip


def _draw_trajectory(axes: Axes, recording: Recording, colour: str) -> None:
    scene, is_caught = recording.scene, recording.has_succeeded
    assert scene.goal is not None
    keys = (scene.curves[0].key, scene.trails[0].key, scene.goal.key)
    fish, head, food = (recording.stack_bl(key).numpy() for key in keys)
    end = f"{float(recording.time[-1]):.1f} T"
    label = f"caught after {end}" if is_caught else f"not caught, {end}"
    axes.add_patch(Polygon(fish[0], closed=True, facecolor=colour, alpha=0.9, lw=0))
    axes.add_patch(Polygon(fish[-1], closed=True, facecolor="none", edgecolor=colour, lw=0.8))
    axes.plot(head[:, 0], head[:, 1], color=colour, linewidth=1.5, label=label)
    axes.plot(food[:, 0], food[:, 1], color=colour, linestyle=":", linewidth=1.1)
    axes.plot(
        *food[-1], marker="*" if is_caught else "X", markersize=13 if is_caught else 8,
        markerfacecolor=FOOD if is_caught else "white", markeredgecolor=colour,
        markeredgewidth=1.2, zorder=4,
    )  # fmt: skip
    reach = scene.goal.reach / scene.body_length
    axes.add_patch(Circle(tuple(food[-1]), reach, fill=False, edgecolor=colour, lw=0.8))
