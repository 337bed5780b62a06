"""Style and colours of all figures."""

from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

#: Okabe and Ito: distinguishable for the colour-blind too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7f3fbf", "#555555")
STYLE: Any = {
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.labelsize": 10,
    "axes.linewidth": 0.8,
    "axes.edgecolor": "#444444",
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.dpi": 150,
}
FISH = "#20252b"
FOOD = "#f2b134"
VORTICITY_LABEL = "vorticity  [1/T]   (red: counter-clockwise)"


def label_axes(axes: Axes, *, x: bool = True, y: bool = True) -> None:
    """Name the axes in body lengths, or hide the tick labels of one that a neighbour names."""
    axes.set(xlabel="x / L" if x else "", ylabel="y / L" if y else "")
    axes.tick_params(labelbottom=x, labelleft=y)


def tidy(axes: Axes) -> None:
    """Draw a faint grid and no frame above and to the right."""
    axes.grid(color="#e6e6e6", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


@contextmanager
def panels(
    path: str | PathLike[str],
    *,
    size: tuple[float, float],
    rows: int = 1,
    columns: int = 1,
    **options: Any,
) -> Iterator[Any]:
    """Yield a grid of axes ``[rows, columns]`` and write the figure when all is drawn.

    Args:
        path: of the PNG.
        size: width and height in inches.
        rows: of the grid.
        columns: of the grid.
        **options: of ``Figure.subplots``, such as ``sharey``.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        yield figure.subplots(rows, columns, squeeze=False, **options)
        figure.savefig(path)
