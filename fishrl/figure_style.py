"""The look of all figures."""

from typing import Any

#: Okabe and Ito: distinguishable for the colour-blind too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7f3fbf", "#555555")
#: Settings of matplotlib for all figures.
STYLE: Any = {
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.labelsize": 10,
    "axes.linewidth": 0.8,
    "axes.edgecolor": "#444444",
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.dpi": 150,
    "text.parse_math": False,  # labels are words
}
