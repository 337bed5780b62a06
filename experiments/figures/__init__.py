"""Figures drawn with matplotlib."""

from experiments.figures.learning_curve import frame_curves, read_metrics, write_learning_curve
from experiments.figures.style import COLOURS, FISH, STYLE, VORTICITY_LABEL

__all__ = [
    "COLOURS",
    "FISH",
    "STYLE",
    "VORTICITY_LABEL",
    "frame_curves",
    "read_metrics",
    "write_learning_curve",
]
