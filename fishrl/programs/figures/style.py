"""Style and colours of all figures."""

from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, LogFormatterMathtext

from fishrl.figure_style import COLOURS, STYLE
from fishrl.files import staged

__all__ = ["COLOURS", "STYLE", "panels", "spell_decades", "tidy"]


def spell_decades(axes: Axes) -> None:
    """Write ticks of logarithmic axes as 1e-07: ``STYLE`` does not parse the markup of 10^-7."""
    for axis in (axes.xaxis, axes.yaxis):
        if isinstance(axis.get_major_formatter(), LogFormatterMathtext):
            axis.set_major_formatter(LogFormatter())
        if isinstance(axis.get_minor_formatter(), LogFormatterMathtext):
            axis.set_minor_formatter(LogFormatter())


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
    has_grid: bool = True,
    **options: Any,
) -> Iterator[Any]:
    """Yield axes ``[rows, columns]`` of a figure of ``size`` inches, and write it at the end.

    They are ``tidy`` unless ``has_grid`` is false, as for images. ``options`` are those of
    ``Figure.subplots``, such as ``sharey``.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, **options)
        for axes in grid.flat if has_grid else ():
            tidy(axes)
        yield grid
        for axes in figure.axes:
            spell_decades(axes)
        with staged(Path(path)) as stage:
            figure.savefig(stage, bbox_inches="tight")  # legends beside the axes, too
