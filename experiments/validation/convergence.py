"""What cases with several resolutions share: the order of an error and its picture."""

from collections.abc import Mapping, Sequence
from math import log

from matplotlib.axes import Axes

from experiments.figures import COLOURS
from experiments.validation.case import Check

GRID = "#e6e6e6"


def fit_order(errors: Mapping[int, float]) -> float:
    """Return p of the least-squares fit error = a n^-p over resolutions n."""
    if len(errors) < 2:
        raise ValueError(f"errors at {sorted(errors)}: an order needs two resolutions")
    x = [log(n) for n in errors]
    y = [log(e) for e in errors.values()]
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    covariance = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    return -covariance / sum((a - mean_x) ** 2 for a in x)


def draw_convergence(
    axes: Axes, series: Mapping[str, Mapping[int, float]], *, order: float = 2.0
) -> None:
    """Draw errors against resolution on logarithmic axes, beside a line of the given order."""
    marks = ("o", "s", "^", "D", "v", "P")
    for (name, errors), colour, mark in zip(series.items(), COLOURS, marks, strict=False):
        hollow = {"markerfacecolor": "none"}
        axes.loglog(
            list(errors), list(errors.values()), color=colour, marker=mark, label=name, **hollow
        )
    sizes = sorted({n for errors in series.values() for n in errors})
    start = 0.5 * min(errors[min(errors)] for errors in series.values())
    slope = [start * (sizes[0] / n) ** order for n in sizes]
    axes.loglog(sizes, slope, color="#777777", linestyle="--", label=f"order {order:g}")
    axes.set_xticks(sizes, [str(n) for n in sizes])
    axes.minorticks_off()
    tidy(axes)
    axes.legend(fontsize=9)


def tidy(axes: Axes) -> None:
    """Give axes a faint grid and no frame above and to the right."""
    axes.grid(color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def find_extreme(positions: Sequence[float], values: Sequence[float], *, sign: int) -> float:
    """Return the largest (``sign`` 1) or smallest (-1) value of a curve between its points.

    The parabola through the extreme point and its two neighbours, evenly spaced, gives the value;
    an extreme at an end is that end's.

    Args:
        positions: of the points, evenly spaced around the extreme.
        values: at the points.
        sign: 1 for the maximum, -1 for the minimum.
    """
    at = max(range(len(values)), key=lambda i: sign * values[i])
    if at in (0, len(values) - 1):
        return values[at]
    step = positions[at + 1] - positions[at]
    if abs(positions[at] - positions[at - 1] - step) > 1e-9 * abs(step):
        raise ValueError(
            f"points around {positions[at]} are not evenly spaced: give those that are"
        )
    before, here, after = values[at - 1], values[at], values[at + 1]
    bend = before - 2.0 * here + after
    return here if bend == 0.0 else here - (after - before) ** 2 / (8.0 * bend)


def check_finest(
    quantity: str,
    values: Mapping[int, float],
    reference: float | tuple[float, float] | None,
    source: str = "",
    tolerance: float | None = None,
    note: str = "",
) -> Check:
    """Return the check of a quantity at its finest resolution, D nodes; the others beside it."""
    return Check(
        quantity=quantity,
        ours=values[max(values)],
        reference=reference,
        source=source,
        tolerance=tolerance,
        resolution=f"D = {max(values)}",
        refinement={f"D = {n}": value for n, value in values.items()},
        note=note,
    )
