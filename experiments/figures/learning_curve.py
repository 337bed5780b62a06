"""The learning curve of a run, from its metrics.csv."""

import csv
from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from experiments.figures.style import COLOURS, panels, tidy

FRAMES = "frames"
# Panels of the learning curve: title, and the columns of metrics.csv that it shows.
PANELS: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    ("return per episode", (("train/return", "training"), ("eval/mean_return", "evaluation"))),
    ("success rate", (("train/success_rate", "training"), ("eval/success_rate", "evaluation"))),
    ("critic loss", (("train/loss_qvalue", "loss"),)),
    ("actor loss", (("train/loss_actor", "loss"),)),
    ("entropy / log(legal actions)", (("train/entropy_fraction", "entropy"),)),
    ("temperature α", (("train/alpha", "α"),)),
)
_SMOOTH_ABOVE = 40

Series = tuple[NDArray[np.float64], NDArray[np.float64]]


def read_metrics(path: str | PathLike[str]) -> dict[str, Series]:
    """Return the frames and values of each column of numbers; blank cells are left out."""
    with Path(path).open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    if not rows or FRAMES not in rows[0]:
        raise ValueError(f"{path} has {len(rows)} rows: needs some, with a column '{FRAMES}'")
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
    """Draw return, success rate, losses, entropy and temperature against env frames.

    Args:
        metrics: ``metrics.csv`` of a run.
        path: of the PNG.
        baselines: success rates by name, drawn as lines.
    """
    series = read_metrics(metrics)
    shown = [
        (title, known)
        for title, columns in PANELS
        if (known := [(c, label) for c, label in columns if c in series and series[c][0].size])
    ]
    if not shown:
        wanted = [column for _, columns in PANELS for column, _ in columns]
        raise ValueError(f"{metrics} has columns {sorted(series)}: needs one or more of {wanted}")
    rows = -(-len(shown) // 2)
    with panels(path, size=(10, 0.5 + 2.3 * rows), rows=rows, columns=2, sharex=True) as grid:
        for i, axes in enumerate(grid.flat):
            if i >= len(shown):
                axes.set_visible(False)
                continue
            title, columns = shown[i]
            for (column, label), colour in zip(columns, COLOURS, strict=False):
                _draw_series(axes, *series[column], label, colour)
            frame_curves(axes, title, is_rate=title == "success rate")
            if title == "success rate":
                _draw_baselines(axes, baselines or {})
            if len(columns) > 1:
                axes.legend(loc="best", fontsize=9)
            is_lowest = i >= len(shown) - 2
            axes.tick_params(labelbottom=is_lowest)
            axes.xaxis.label.set_visible(is_lowest)


def frame_curves(axes: Axes, title: str, *, is_rate: bool) -> None:
    """Give axes of learning curves their title, label and grid; rates go from 0 to 100 %."""
    axes.set_title(title, loc="left")
    axes.set_xlabel("env frames (decisions of all fish)")
    tidy(axes)
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
    window = np.ones(2 * max(1, y.size // 40) + 1)
    mean = np.convolve(y, window, "same") / np.convolve(np.ones_like(y), window, "same")
    axes.plot(x, mean, color=colour, label=label, linewidth=1.8)


def _draw_baselines(axes: Axes, baselines: Mapping[str, float]) -> None:
    height = -1.0
    for name, rate in sorted(baselines.items(), key=lambda item: item[1]):
        height = max(rate, height + 0.075)  # names of near rates stand above each other
        axes.axhline(rate, color="#777777", linewidth=1.0, linestyle="--", zorder=1)
        axes.annotate(
            f"{name} {rate:.0%}", (1.0, height), xycoords=("axes fraction", "data"), xytext=(3, 0),
            textcoords="offset points", va="center", fontsize=8, color="#555555",
        )  # fmt: skip
