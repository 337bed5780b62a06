"""Paths of several episodes on one sheet."""

from collections.abc import Sequence
from os import PathLike

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from experiments.figures.style import COLOURS, FOOD, label_axes, panels
from fishrl.viewer import Recording


def write_trajectories(recordings: Sequence[Recording], path: str | PathLike[str]) -> None:
    """Draw head paths from several starts, the goal's path and where it was reached.

    Args:
        recordings: one or more episodes of one task whose scene has a goal.
        path: of the PNG.
    """
    scene = recordings[0].scene
    x, y = scene.width / scene.body_length, scene.height / scene.body_length
    with panels(path, size=(9, 0.5 + 6.6 * y / x)) as [[axes]]:
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
    fish, head, food = (
        recording.stack_bl(key).numpy()
        for key in (scene.curves[0].key, scene.trails[0].key, scene.goal.key)
    )
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
