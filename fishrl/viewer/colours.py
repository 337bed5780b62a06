"""Colours of fields, marks and lines; round limits and tick distances."""

from math import floor, log10

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from fishrl.figure_style import COLOURS

#: Colour maps of matplotlib: blue-white-red, purple-white-green and white-blue.
RED_BLUE, PURPLE_GREEN, WHITE_BLUE = "RdBu_r", "PRGn", "Blues"
#: Colours of lines in plots, 0 to 255.
LINES = tuple(tuple(bytes.fromhex(colour[1:])) for colour in COLOURS)

_NICE_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)


def quantise(values: NDArray[np.float32], low: float, high: float) -> NDArray[np.uint8]:
    """Return levels 1 to 255 of values between ``low`` and ``high``; NaN counts as zero."""
    scaled = np.clip((np.nan_to_num(values) - low) / (high - low), 0.0, 1.0)
    levels: NDArray[np.uint8] = np.round(scaled * 254.0 + 1.0).astype(np.uint8)
    return levels


def paint(levels: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
    """Return the colours ``[..., 3]`` of levels in a colour map."""
    at = np.clip((np.arange(256) - 1) / 254.0, 0.0, 1.0)
    painted: NDArray[np.uint8] = colormaps[name](at, bytes=True)[:, :3][levels]
    return painted


def round_limit(value: float, steps: tuple[float, ...] = _NICE_STEPS) -> float:
    """Return the least round number >= ``value``: one of ``steps`` times a power of ten."""
    scale = 10.0 ** floor(log10(value))
    return next(step * scale for step in steps if step * scale >= value * (1 - 1e-9))


def space_ticks(length: float) -> float:
    """Return a tick distance, 1, 2 or 5 times a power of ten, for about six ticks in a length."""
    return round_limit(length / 6.0, (1.0, 2.0, 5.0, 10.0))
