"""What cases with several resolutions share: the order of an error and its picture."""

from collections.abc import Mapping, Sequence
from math import log
from statistics import linear_regression

from matplotlib.axes import Axes

from experiments.figures import COLOURS

GREY = "#777777"


def fit_order(errors: Mapping[int, float]) -> float:
    """Return p of the least-squares fit error = a n^-p over two or more resolutions n."""
    return -linear_regression([log(n) for n in errors], [log(e) for e in errors.values()]).slope


def find_extreme(values: Sequence[float], *, sign: int) -> float:
    """Return the largest (``sign`` 1) or smallest (-1) value of a curve between its points.

    The parabola through the extreme point and its two neighbours gives the value; an extreme at an
    end is that end's.

    Args:
        values: at evenly spaced points.
        sign: 1 for the maximum, -1 for the minimum.
    """
    at = max(range(len(values)), key=lambda i: sign * values[i])
    if at in (0, len(values) - 1):
        return values[at]
    before, here, after = values[at - 1], values[at], values[at + 1]
    bend = before - 2.0 * here + after
    return here if bend == 0.0 else here - (after - before) ** 2 / (8.0 * bend)


def draw_convergence(axes: Axes, series: Mapping[str, Mapping[int, float]]) -> None:
    """Draw errors against resolution on logarithmic axes, beside a line of second order."""
    for (name, errors), colour, mark in zip(series.items(), COLOURS, "os^DvP", strict=False):
        axes.loglog(
            list(errors), list(errors.values()), color=colour, marker=mark, label=name,
            markerfacecolor="none",
        )  # fmt: skip
    sizes = sorted({n for errors in series.values() for n in errors})
    start = 0.5 * min(errors[min(errors)] for errors in series.values())
    slope = [start * (sizes[0] / n) ** 2 for n in sizes]
    axes.loglog(sizes, slope, color=GREY, linestyle="--", label="order 2")
    axes.set_xticks(sizes, [str(n) for n in sizes])
    axes.minorticks_off()
    axes.legend(fontsize=9)
