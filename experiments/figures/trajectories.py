"""Paths of several episodes on one sheet."""

import math
from collections.abc import Sequence
from os import PathLike

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from experiments.figures.style import COLOURS, FOOD, STYLE, label_axes
from experiments.recording import Recording


def write_trajectories(recordings: Sequence[Recording], path: str | PathLike[str]) -> None:
    """Draw head paths from several starts, the food's travel and where it was caught.

    Args:
        recordings: one or more episodes of one task.
        path: of the PNG.
    """
    if not recordings:
        raise ValueError("recordings is empty: record at least one episode")
    if len({(r.domain, r.body_length) for r in recordings}) > 1:
        raise ValueError("recordings differ in domain or body length: draw them apart")
    first = recordings[0]
    length = first.body_length
    x, y = (n / length for n in first.domain)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 0.5 + 6.6 * y / x), layout="constrained")
        axes = figure.subplots()
        for i, recording in enumerate(recordings):
            _draw_trajectory(axes, recording, COLOURS[i % len(COLOURS)])
        axes.set(xlim=(0, x), ylim=(0, y), aspect="equal")
        label_axes(axes)
        axes.legend(
            loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, fontsize=9,
            title="filled: at the start\nline: head · dots: food\ncircle: capture radius",
            title_fontsize=8.5, alignment="left", labelspacing=0.55,
        )  # fmt: skip
        figure.savefig(path)


def _draw_trajectory(axes: Axes, recording: Recording, colour: str) -> None:
    length = recording.body_length
    head, food = (recording.head / length).numpy(), (recording.food / length).numpy()
    end = f"{float(recording.time[-1]):.1f} T"
    label = f"caught after {end}" if recording.captured else f"not caught, {end}"
    first, last = ((recording.outline[i] / length).numpy() for i in (0, -1))
    axes.add_patch(Polygon(first, closed=True, facecolor=colour, alpha=0.9, lw=0))
    axes.add_patch(Polygon(last, closed=True, facecolor="none", edgecolor=colour, lw=0.8))
    axes.plot(head[:, 0], head[:, 1], color=colour, linewidth=1.5, label=label)
    axes.plot(food[:, 0], food[:, 1], color=colour, linestyle=":", linewidth=1.1)
    marker = "*" if recording.captured else "X"
    size = 13 if recording.captured else 8
    axes.plot(
        *food[-1], marker=marker, markersize=size, markerfacecolor=FOOD if recording.captured
        else "white", markeredgecolor=colour, markeredgewidth=1.2, zorder=4,
    )  # fmt: skip
    reach = recording.capture_radius / length
    if math.isfinite(reach):
        axes.add_patch(Circle(tuple(food[-1]), reach, fill=False, edgecolor=colour, lw=0.8))
