"""The look of all figures."""

from typing import Any

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
