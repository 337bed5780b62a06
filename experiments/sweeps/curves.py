"""Learning curves of a sweep: the mean over the seeds of each group, with its 95 % interval."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from experiments.figures import COLOURS, STYLE, frame_curves, read_metrics
from experiments.statistics import half_width
from experiments.sweeps.groups import Group

#: Panels: title and column of metrics.csv.
PANELS = (
    ("rate of success", "eval/success_rate"),
    ("return per episode", "eval/mean_return"),
    ("return while learning", "train/return"),
)
_DASHES = ("-", "--", ":", "-.")
Numbers = NDArray[np.float64]


def write_curves(groups: Sequence[Group], path: Path) -> bool:
    """Draw the curves of all groups against env frames.

    Args:
        groups: their runs count as far as they have come, unfinished ones too.
        path: of the PNG.

    Returns:
        Whether there was anything to draw.
    """
    drawn = [
        (title, [(group, *curve) for group in groups if (curve := average(group, column))[0].size])
        for title, column in PANELS
    ]
    drawn = [(title, curves) for title, curves in drawn if curves]
    if not drawn:
        return False
    with mpl.rc_context(STYLE):
        rows = 1 + len(groups) // 12
        figure = Figure(figsize=(4.2 * len(drawn), 3.6 + 0.3 * rows), layout="constrained")
        row = figure.subplots(1, len(drawn), squeeze=False, sharex=True)[0]
        for axes, (title, curves) in zip(row, drawn, strict=True):
            _draw(axes, title, curves, groups)
        handles, labels = row[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(groups)))
        figure.suptitle("mean over the seeds, band: its 95 % confidence interval", fontsize=9)
        figure.savefig(path)
    return True


def average(group: Group, column: str) -> tuple[Numbers, Numbers, Numbers]:
    """Return frames, mean over the seeds, and half-width of its 95 % interval.

    At each frame that any run has logged, the runs count that have begun and come so far, linearly
    interpolated.

    Args:
        group: of runs.
        column: of metrics.csv.
    """
    series = []
    for run in group.seeds:
        if run.frames == 0:
            continue
        x, y = read_metrics(run.path / "metrics.csv").get(column, (np.empty(0), np.empty(0)))
        if x.size:
            series.append((x, y))
    frames = np.unique(np.concatenate([x for x, _ in series])) if series else np.empty(0)
    mean, half = np.empty_like(frames), np.empty_like(frames)
    for i, frame in enumerate(frames):
        values = [float(np.interp(frame, x, y)) for x, y in series if x[0] <= frame <= x[-1]]
        mean[i], half[i] = np.mean(values), half_width(values)
    return frames, mean, half


def _draw(
    axes: Axes,
    title: str,
    curves: Sequence[tuple[Group, Numbers, Numbers, Numbers]],
    groups: Sequence[Group],
) -> None:
    for group, frames, mean, half in curves:
        number = groups.index(group)
        colour = COLOURS[number % len(COLOURS)]
        dashes = _DASHES[number // len(COLOURS) % len(_DASHES)]
        marker = "o" if frames.size <= 20 else ""
        axes.plot(
            frames, mean, color=colour, linestyle=dashes, marker=marker, markersize=3,
            linewidth=1.6, label=group.label,
        )  # fmt: skip
        axes.fill_between(frames, mean - half, mean + half, color=colour, alpha=0.15, linewidth=0)
    frame_curves(axes, title, is_rate=title == PANELS[0][0])
