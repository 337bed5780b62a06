"""Style and colours of all figures."""

from typing import Any

from matplotlib.axes import Axes

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
