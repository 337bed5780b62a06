"""Colours of fields, of values of marks and of lines; distances of ticks."""

from math import floor, log10

import numpy as np
from numpy.typing import NDArray

#: ColorBrewer RdBu, from -1 (blue) over 0 (white) to 1 (red).
RED_BLUE = (
    (5, 48, 97), (33, 102, 172), (67, 147, 195), (146, 197, 222), (209, 229, 240), (247, 247, 247),
    (253, 219, 199), (244, 165, 130), (214, 96, 77), (178, 24, 43), (103, 0, 31),
)  # fmt: skip
#: ColorBrewer PRGn, from -1 (purple) over 0 (white) to 1 (green).
PURPLE_GREEN = (
    (64, 0, 75), (118, 42, 131), (153, 112, 171), (194, 165, 207), (231, 212, 232), (247, 247, 247),
    (217, 240, 211), (166, 219, 160), (90, 174, 97), (27, 120, 55), (0, 68, 27),
)  # fmt: skip
#: ColorBrewer YlGnBu with white at its lower end, from 0 (white) to 1 (dark blue).
WHITE_BLUE = (
    (255, 255, 255), (237, 248, 177), (199, 233, 180), (127, 205, 187), (65, 182, 196),
    (29, 145, 192), (34, 94, 168), (37, 52, 148), (8, 29, 88),
)  # fmt: skip
#: Colours of lines in plots, by Okabe and Ito, which colour-blind readers can distinguish.
LINES = (
    (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (230, 159, 0),
    (127, 63, 191), (110, 110, 110),
)  # fmt: skip

_NICE_STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)
Table = tuple[tuple[int, int, int], ...]


def quantise(values: NDArray[np.float32], low: float, high: float) -> NDArray[np.uint8]:
    """Return levels 1 to 255 of values between ``low`` and ``high``; NaN counts as zero."""
    scaled = np.clip((np.nan_to_num(values) - low) / (high - low), 0.0, 1.0)
    levels: NDArray[np.uint8] = np.round(scaled * 254.0 + 1.0).astype(np.uint8)
    return levels


def paint(levels: NDArray[np.uint8], table: Table) -> NDArray[np.uint8]:
    """Return the colours ``[..., 3]`` of levels."""
    at = np.clip((np.arange(256) - 1) / 254.0, 0.0, 1.0)
    position = np.linspace(0.0, 1.0, len(table))
    colours = np.stack([np.interp(at, position, c) for c in zip(*table, strict=True)], 1)
    painted: NDArray[np.uint8] = np.round(colours).astype(np.uint8)[levels]
    return painted


def round_up(value: float, steps: tuple[float, ...] = _NICE_STEPS) -> float:
    """Return the next round number: one of ``steps`` times a power of ten."""
    scale = 10.0 ** floor(log10(value))
    return next(step * scale for step in steps if step * scale >= value * (1 - 1e-9))


def space_ticks(length: float) -> float:
    """Return a distance of ticks, 1, 2 or 5 times a power of ten, for at most six in a length."""
    return round_up(length / 6.0, (1.0, 2.0, 5.0, 10.0))
