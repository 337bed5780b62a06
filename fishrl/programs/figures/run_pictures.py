"""The pictures of a run: episodes of its policy and its learning curve."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from itertools import cycle
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
    make_env_scene,
    name_flows,
    record_episodes,
    start_drawing,
)
from fishrl.viewer.film import FOOD, label_axes, write_film, write_flow, write_snapshots

#: Number of flows kept in ``episode.rrd``.
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
    scene = make_env_scene(env, settings, policy=folder.name)
    flows, num_rows = list(range(min(_MAX_FLOWS, len(starts)))), env.batch_size[0]
    max_decisions = None if scene.goal else count_decisions(task, _MAX_PERIODS)
    recordings = [Recording(scene=scene) for _ in range(len(starts))]
    drawing = start_drawing(
        scene,
        flows=name_flows(task, flows, starts),
        save=folder / "episode.rrd",
        field_format=settings.field_format,
    )
    with closing(drawing):

        def give(first: int, start: int, frame: Frame) -> None:
            recordings[first + start].frames.append(frame)
            if first + start in flows:
                drawing.draw(first + start, frame)

        for first in range(0, len(starts), num_rows):  # after max_decisions no other one begins
            record_episodes(
                env,
                policy,
                starts[first : first + num_rows],
                scene=scene,
                give=partial(give, first),
                frames_per_T=settings.frames_per_T,
                max_decisions=max_decisions,
                on_episodes=on_episodes,
            )
    write_run_pictures(folder, recordings, baselines=baselines)


def write_run_pictures(
    folder: Path, recordings: Sequence[Recording], *, baselines: Mapping[str, float]
) -> None:
    """Write the learning curve and pictures of the episodes.

    All ``recordings`` go into ``trajectories.png``; the first one that succeeded (else the first
    one) into the flow pictures and the film.
    """
    if (folder / "metrics.csv").is_file():
        curve = folder / "learning_curve.png"
        write_learning_curve(folder / "metrics.csv", curve, baselines=baselines)
    successes = (r for r in recordings if r.ending is not None and r.ending.is_success)
    shown = next(successes, recordings[0])
    write_trajectories(recordings, folder / "trajectories.png")
    field = shown.scene.field.key
    write_snapshots(shown, folder / f"{field}_sequence.png")
    write_flow(shown, folder / f"{field}_last.png")
    write_film(shown, folder / "episode.gif")


def write_trajectories(recordings: Sequence[Recording], path: Path) -> None:
    """Draw head paths from several starts among the obstacles, and the goal's, if there is one."""
    scene = recordings[0].scene
    x, y = scene.width / scene.body_length, scene.height / scene.body_length
    words = ["filled: fish at the start", "line: head"]
    if scene.goal is not None:
        words += [f"dots: {scene.goal.name}", f"circle: reach of the {scene.goal.name}"]
    with panels(path, size=(9, 0.5 + 6.6 * y / x), has_grid=False) as [[axes]]:
        bodies = [curve for curve in scene.curves if curve.is_closed and curve.is_filled]
        for body in bodies[len(scene.trails) :]:  # after the fish
            outlines = [recording.stack_bl(body.key)[0].numpy() for recording in recordings]
            if all((outline == outlines[0]).all() for outline in outlines):
                axes.add_patch(Polygon(outlines[0], closed=True, facecolor="0.45", lw=0))
                words.append("grey: obstacle")
                continue
            for outline, colour in zip(outlines, cycle(COLOURS), strict=False):
                axes.add_patch(Polygon(outline, closed=True, facecolor="none", edgecolor=colour))
            words.append("outline: obstacle")
        for number, recording in enumerate(recordings):
            _draw_trajectory(axes, recording, COLOURS[number % len(COLOURS)])
        axes.set(xlim=(0, x), ylim=(0, y), aspect="equal", title=scene.title)
        label_axes(axes)
        axes.legend(
            loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, fontsize=9,
            title="\n".join(dict.fromkeys(words)), title_fontsize=8.5, alignment="left",
            labelspacing=0.55,
        )  # fmt: skip


def _draw_trajectory(axes: Axes, recording: Recording, colour: str) -> None:
    scene, ending = recording.scene, recording.ending
    words = "" if ending is None else f", {ending.words}"
    label = f"{float(recording.time[-1]):.1f} T{words}"
    for number, trail in enumerate(scene.trails):
        fish, head = (
            recording.stack_bl(key).numpy() for key in (scene.curves[number].key, trail.key)
        )
        axes.add_patch(Polygon(fish[0], closed=True, facecolor=colour, alpha=0.9, lw=0))
        axes.add_patch(Polygon(fish[-1], closed=True, facecolor="none", edgecolor=colour, lw=0.8))
        axes.plot(*head.T, color=colour, linewidth=1.5, label=None if number else label)
    if scene.goal is None:
        return
    is_reached = ending is not None and ending.is_success
    goal = recording.stack_bl(scene.goal.key).numpy()
    axes.plot(*goal.T, color=colour, linestyle=":", linewidth=1.1)
    axes.plot(
        *goal[-1], marker="*" if is_reached else "X", markersize=13 if is_reached else 8,
        markerfacecolor=FOOD if is_reached else "white", markeredgecolor=colour,
        markeredgewidth=1.2, zorder=4,
    )  # fmt: skip
    reach = scene.goal.reach / scene.body_length
    axes.add_patch(Circle(tuple(goal[-1]), reach, fill=False, edgecolor=colour, lw=0.8))
