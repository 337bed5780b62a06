"""Learning curves: of a run, from its metrics.csv, and of the groups of a sweep."""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from fishrl.programs.figures.style import COLOURS, panels
from fishrl.training.logger import read_rows

FRAMES = "frames"
#: Title of the panel in percent, which shows baselines too.
RATE = "success rate"
#: Panels of a run and their columns of metrics.csv, while training and in evaluations.
PANELS = {
    "return per episode": ("train/return", "eval/mean_return"),
    RATE: ("train/success_rate", "eval/success_rate"),
    "critic loss": ("train/loss_qvalue",),
    "actor loss": ("train/loss_actor",),
    "critic loss of PPO": ("train/loss_critic",),
    "actor loss of PPO": ("train/loss_objective",),
    "entropy [nats]": ("train/entropy",),
    "entropy / log(legal actions)": ("train/entropy_fraction",),
    "temperature α": ("train/alpha",),
}
_TERM = "eval/reward/"
LABELS = ("training", "evaluation")
DASHES = ("-", "--", ":", "-.")
_SMOOTH_ABOVE = 40
Numbers = NDArray[np.float64]


class Curve(NamedTuple):
    """One curve; ``band`` is the half-width of an interval, ``number`` chooses the colour."""

    label: str
    x: Numbers
    y: Numbers
    band: Numbers | None = None
    number: int = 0


def read_metrics(path: str | PathLike[str]) -> dict[str, tuple[Numbers, Numbers]]:
    """Return the frames and values of each column of numbers; blank cells are left out."""
    rows = read_rows(Path(path))
    if not rows:
        raise ValueError(f"{path}: has no rows yet")
    series = {}
    for name in rows[0]:
        points = [(row[FRAMES], row[name]) for row in rows if row[name]]
        values = np.array(points, dtype=np.float64).reshape(-1, 2)
        values = values[np.isfinite(values).all(1)]
        series[name] = (values[:, 0], values[:, 1])
    return series


def write_learning_curve(
    metrics: str | PathLike[str],
    path: str | PathLike[str],
    *,
    baselines: Mapping[str, float] | None = None,
) -> None:
    """Draw return, its terms, success rate, losses, entropy, temperature against env frames."""
    series = read_metrics(metrics)
    if "train/entropy_fraction" in series:  # which says more
        series.pop("train/entropy", None)
    curves = {
        title: [
            Curve(LABELS[i], *series[column], number=i)
            for i, column in enumerate(columns)
            if column in series
        ]
        for title, columns in PANELS.items()
    }
    curves |= {  # in evaluations alone
        f"{name.removeprefix(_TERM)}, of the return": [Curve(LABELS[1], *series[name], number=1)]
        for name in series
        if name.startswith(_TERM)
    }
    if not draw_curves(path, curves, baselines=baselines):
        wanted = [column for columns in PANELS.values() for column in columns]
        raise ValueError(f"{metrics} has columns {sorted(series)}: needs one or more of {wanted}")


def draw_curves(
    path: str | PathLike[str],
    curves: Mapping[str, Sequence[Curve]],
    *,
    baselines: Mapping[str, float] | None = None,
) -> bool:
    """Draw a panel of curves for each title that has any; return whether one has.

    ``baselines`` are success rates by name, drawn as lines.
    """
    shown = {title: [c for c in given if c.x.size] for title, given in curves.items()}
    shown = {title: drawn for title, drawn in shown.items() if drawn}
    if not shown:
        return False
    every = [curve for drawn in shown.values() for curve in drawn]
    has_bands = any(curve.band is not None for curve in every)
    rows, labels = -(-len(shown) // 2), {curve.label for curve in every}
    longest = max(map(len, labels))
    columns = max(1, min(4, 120 // (longest + 8)))  # 120 characters fit in a row
    lines = len(labels) // columns
    size = (10.0, 0.5 + 2.3 * rows + 0.25 * lines)
    with panels(path, size=size, rows=rows, columns=2, sharex=True) as grid:
        handles: dict[str, object] = {}
        for axes in grid.flat[len(shown) :]:
            axes.set_visible(False)
        for i, (axes, (title, drawn)) in enumerate(zip(grid.flat, shown.items(), strict=False)):
            handles |= {curve.label: _draw_curve(axes, curve) for curve in drawn}
            axes.set_title(title, loc="left")
            if title == RATE:
                axes.set_ylim(-0.03, 1.05)
                axes.yaxis.set_major_formatter("{x:.0%}")
                _draw_baselines(axes, baselines or {})
            if i >= len(shown) - 2:
                axes.set_xlabel("env frames (decisions of all flows)")
                axes.tick_params(labelbottom=True)
        if has_bands or len(handles) > 1:
            note = "mean over the seeds, band: its 95 % confidence interval" if has_bands else None
            grid[0, 0].figure.legend(
                handles.values(), handles, loc="outside lower center", ncols=columns, title=note
            )
    return True


def _draw_curve(axes: Axes, curve: Curve) -> object:
    """Draw a curve and its band; a long curve without a band is drawn with its running mean."""
    _, x, y, band, number = curve
    colour, marker = COLOURS[number % len(COLOURS)], ""
    dashes = DASHES[number // len(COLOURS) % len(DASHES)]
    if y.size <= _SMOOTH_ABOVE:
        marker = "o"
    elif band is None:
        axes.plot(x, y, color=colour, alpha=0.22, linewidth=0.8)
        window = np.ones(2 * max(1, y.size // 40) + 1)
        y = np.convolve(y, window, "same") / np.convolve(np.ones_like(y), window, "same")
    if band is not None:
        axes.fill_between(x, y - band, y + band, color=colour, alpha=0.15, linewidth=0)
    (line,) = axes.plot(
        x, y, color=colour, linestyle=dashes, marker=marker, markersize=3, linewidth=1.7
    )
    return line


def _draw_baselines(axes: Axes, baselines: Mapping[str, float]) -> None:
    height = -1.0
    for name, rate in sorted(baselines.items(), key=lambda item: item[1]):
        height = max(rate, height + 0.075)  # names of near rates stand above each other
        axes.axhline(rate, color="#777777", linewidth=1.0, linestyle="--", zorder=1)
        axes.annotate(
            f"{name} {rate:.0%}", (1.0, height), xycoords=("axes fraction", "data"), xytext=(3, 0),
            textcoords="offset points", va="center", fontsize=8, color="#555555",
        )  # fmt: skip
