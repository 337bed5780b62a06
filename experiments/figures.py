"""What a run looks like: learning curve, trajectories, flow, animation."""

import csv
import math
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

from experiments.flow_pictures import (
    FOOD,
    STYLE,
    label_axes,
    write_animation,
    write_flow,
    write_snapshots,
)
from experiments.recording import Recording

# Okabe and Ito: told apart by the colour-blind too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7f3fbf", "#555555")
FRAMES = "frames"
# Panels of the learning curve: title, and the columns of metrics.csv that it shows.
PANELS: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    ("return per episode", (("train/return", "training"), ("eval/mean_return", "evaluation"))),
    ("rate of success", (("train/success_rate", "training"), ("eval/success_rate", "evaluation"))),
    ("critic loss", (("train/loss_qvalue", "loss"),)),
    ("actor loss", (("train/loss_actor", "loss"),)),
    ("entropy / log(legal actions)", (("train/entropy_fraction", "entropy"),)),
    ("temperature α", (("train/alpha", "α"),)),
)
_SMOOTH_ABOVE = 40

Series = tuple[NDArray[np.float64], NDArray[np.float64]]


def write_run_pictures(
    run_dir: str | PathLike[str],
    recordings: Sequence[Recording],
    *,
    baselines: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write every picture of a run.

    Args:
        run_dir: run folder; ``metrics.csv`` in it becomes the learning curve, if it is there.
        recordings: episodes; all go into ``trajectories.png``, and the first one that ended with a
            capture (else the first one) into the flow pictures and the animation.
        baselines: rates of success of swimmers that do not learn, by name, drawn as lines.

    Returns:
        The files, in the order written.
    """
    if not recordings:
        raise ValueError("recordings is empty: record at least one episode")
    folder = Path(run_dir)
    if not folder.is_dir():
        raise FileNotFoundError(f"no run folder {folder}: give one that exists")
    shown = next((r for r in recordings if r.captured), recordings[0])
    written = []
    if (folder / "metrics.csv").is_file():
        written.append(folder / "learning_curve.png")
        write_learning_curve(folder / "metrics.csv", written[-1], baselines=baselines)
    written.append(folder / "trajectories.png")
    write_trajectories(recordings, written[-1])
    written.append(folder / "vorticity_sequence.png")
    write_snapshots(shown, written[-1])
    written.append(folder / "vorticity_last.png")
    write_flow(shown, written[-1])
    written.append(folder / "capture.gif")
    write_animation(shown, written[-1])
    return written


def read_metrics(path: str | PathLike[str]) -> dict[str, Series]:
    """Return the frames and values of each column of numbers; blank cells are left out."""
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"no metrics at {file}: give the metrics.csv of a run folder")
    with file.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    if not rows or FRAMES not in rows[0]:
        columns = sorted(rows[0]) if rows else []
        raise ValueError(f"{file} has {len(rows)} rows and columns {columns}: needs '{FRAMES}'")
    series: dict[str, Series] = {}
    for name in rows[0]:
        points = [(row[FRAMES], row[name]) for row in rows if row[name] and row[FRAMES]]
        try:
            values = np.array(points, dtype=np.float64).reshape(-1, 2)
        except ValueError:
            continue  # a column of words is nothing to plot
        values = values[np.isfinite(values).all(1)]
        series[name] = (values[:, 0], values[:, 1])
    return series


def write_learning_curve(
    metrics: str | PathLike[str],
    path: str | PathLike[str],
    *,
    baselines: Mapping[str, float] | None = None,
) -> None:
    """Draw return, rate of success, losses, entropy and temperature against env frames.

    Args:
        metrics: ``metrics.csv`` of a run.
        path: of the PNG.
        baselines: rates of success of swimmers that do not learn, by name, drawn as lines.
    """
    series = read_metrics(metrics)
    panels = [
        (title, known)
        for title, columns in PANELS
        if (known := [(c, label) for c, label in columns if c in series and series[c][0].size])
    ]
    if not panels:
        wanted = [column for _, columns in PANELS for column, _ in columns]
        raise ValueError(f"{metrics} has columns {sorted(series)}: needs one or more of {wanted}")
    rows = -(-len(panels) // 2)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10, 0.5 + 2.3 * rows), layout="constrained")
        grid = figure.subplots(rows, 2, squeeze=False, sharex=True)
        for axes in list(grid.flat)[len(panels) :]:
            axes.set_visible(False)
        for axes, (title, columns) in zip(grid.flat, panels, strict=False):
            for (column, label), colour in zip(columns, COLOURS, strict=False):
                _draw_series(axes, *series[column], label, colour)
            axes.set_title(title, loc="left")
            axes.grid(color="#e6e6e6", linewidth=0.7)
            axes.spines[["top", "right"]].set_visible(False)
            if title == "rate of success":
                _draw_baselines(axes, baselines or {})
            if len(columns) > 1:
                axes.legend(loc="best", fontsize=9)
        for axes in list(grid.flat)[max(0, len(panels) - 2) : len(panels)]:
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("env frames (decisions of all fish)")
        figure.savefig(path)


def frame_curves(axes: Axes, title: str, *, is_rate: bool) -> None:
    """Give axes of learning curves their title, label and grid; rates go from 0 to 100 %."""
    axes.set_title(title, loc="left")
    axes.set_xlabel("env frames (decisions of all fish)")
    axes.grid(color="#e6e6e6", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    if is_rate:
        axes.set_ylim(-0.03, 1.05)
        axes.yaxis.set_major_formatter("{x:.0%}")


def _draw_series(
    axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], label: str, colour: str
) -> None:
    """Draw a series; a long one as a centred running mean over a faint original."""
    if y.size <= _SMOOTH_ABOVE:
        axes.plot(x, y, color=colour, label=label, marker="o", markersize=3.5, linewidth=1.6)
        return
    axes.plot(x, y, color=colour, alpha=0.22, linewidth=0.8)
    reach = max(1, y.size // 40)
    at = np.arange(y.size)
    start, stop = np.maximum(at - reach, 0), np.minimum(at + reach + 1, y.size)
    sums = np.concatenate(([0.0], np.cumsum(y)))
    mean = (sums[stop] - sums[start]) / (stop - start)
    axes.plot(x, mean, color=colour, label=label, linewidth=1.8)


def _draw_baselines(axes: Axes, baselines: Mapping[str, float]) -> None:
    axes.set_ylim(-0.03, 1.05)
    axes.yaxis.set_major_formatter("{x:.0%}")
    height = -1.0
    for name, rate in sorted(baselines.items(), key=lambda item: item[1]):
        height = max(rate, height + 0.075)  # names of near rates stand above each other
        axes.axhline(rate, color="#777777", linewidth=1.0, linestyle="--", zorder=1)
        axes.annotate(
            f"{name} {rate:.0%}", (1.0, height), xycoords=("axes fraction", "data"), xytext=(3, 0),
            textcoords="offset points", va="center", fontsize=8, color="#555555",
        )  # fmt: skip


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
