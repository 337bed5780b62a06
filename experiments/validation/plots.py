"""Parts of figures, and the order of convergence."""

from collections.abc import Iterable, Mapping, Sequence
from math import log
from statistics import linear_regression
from typing import Any

from matplotlib.axes import Axes

GREY = "#777777"


def draw_reference(axes: Axes, points: Iterable[Sequence[float]], name: str) -> None:
    """Draw published points (x, y) as black circles."""
    marks: Any = {"color": "black", "markerfacecolor": "none", "markersize": 5}
    axes.plot(*zip(*points, strict=True), "o", label=name, **marks)


def draw_convergence(axes: Axes, series: Mapping[str, Mapping[int, float]]) -> None:
    """Draw errors against resolution on logarithmic axes, with a line of second order."""
    for (name, errors), mark in zip(series.items(), "os^DvP", strict=False):
        points = [*errors], [*errors.values()]
        axes.loglog(*points, marker=mark, label=name, markerfacecolor="none")
    sizes = sorted({n for errors in series.values() for n in errors})
    start = 0.5 * min(errors[min(errors)] for errors in series.values())
    slope = [start * (sizes[0] / n) ** 2 for n in sizes]
    axes.loglog(sizes, slope, color=GREY, linestyle="--", label="order 2")
    name_ticks(axes, sizes)


def name_ticks(axes: Axes, values: Sequence[float]) -> None:
    """Name these values, and no others, on a logarithmic x axis."""
    axes.set_xticks(values, [f"{value:.0f}" for value in values])
    axes.minorticks_off()


def fit_order(errors: Mapping[int, float]) -> float:
    """Return p of the least-squares fit error = a n^-p over two or more resolutions n."""
    return -linear_regression([log(n) for n in errors], [log(e) for e in errors.values()]).slope
