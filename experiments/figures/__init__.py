"""Figures drawn with matplotlib."""

from experiments.figures.learning_curve import read_metrics, write_learning_curve
from experiments.figures.style import COLOURS, STYLE

__all__ = ["COLOURS", "STYLE", "read_metrics", "write_learning_curve"]
