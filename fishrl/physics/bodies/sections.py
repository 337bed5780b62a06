"""Half-thickness of bodies along their axis."""

from enum import Enum

import numpy as np
from numpy.typing import NDArray

_Values = NDArray[np.float64]


class Section(Enum):
    """A family of half-thicknesses.

    ``NACA``: symmetric NACA 4-digit section (Jacobs, Ward & Pinkerton 1933), with -0.1036 x^4 for a
    closed trailing edge; thickness 0.12 for NACA0012.

    ``EEL``: the two-dimensional eel of Kern & Koumoutsakos 2006, as in the open-source CubismUP 2D
    (``CarlingFish``, thickness 0.08): a round head of radius w = thickness / 2, a body that thins
    linearly from w at x = w to w / 4 at 0.95, and a pointed tail.

    ``LARVA``: the larval zebrafish of Gazzola et al. 2012, as in CubismUP 2D (``CStartFish``,
    thickness 0.127): an elliptic head up to x = 0.0862, a cubic down to 0.4 of the thickness at
    0.3448, and a parabola to the tail.
    """

    NACA = "naca"
    EEL = "eel"
    LARVA = "larva"

    def compute_half_thickness(self, x: _Values, thickness: float) -> _Values:
        """Return the half-thickness at ``x`` from the nose; both in body lengths."""
        draw = {Section.NACA: _draw_naca, Section.EEL: _draw_eel, Section.LARVA: _draw_larva}
        values: _Values = draw[self](x, thickness)
        return np.maximum(values, 0.0)


def _draw_naca(x: _Values, thickness: float) -> _Values:
    poly = 0.2969 * np.sqrt(x) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4
    return np.asarray(5.0 * thickness * poly, dtype=np.float64)


def _draw_eel(x: _Values, thickness: float) -> _Values:
    head, tail, tail_at = 0.5 * thickness, 0.125 * thickness, 0.95
    body = head - (head - tail) * (x - head) / (tail_at - head)
    values = np.where(x < head, np.sqrt(np.maximum(2.0 * head * x - x * x, 0.0)), body)
    return np.where(x > tail_at, tail * (1.0 - x) / (1.0 - tail_at), values)


def _draw_larva(x: _Values, thickness: float) -> _Values:
    head, tail = 0.5 * thickness, 0.2 * thickness
    head_at, tail_at = 0.0862, 0.3448
    nose = head * np.sqrt(np.maximum(1.0 - ((head_at - x) / head_at) ** 2, 0.0))
    part, slope = (x - head_at) / (tail_at - head_at), tail * (tail_at - head_at)
    drop = tail - head
    body = head + (3.0 * drop + slope) * part**2 - (2.0 * drop + slope) * part**3
    end = tail * (1.0 - ((x - tail_at) / (1.0 - tail_at)) ** 2)
    return np.where(x < head_at, nose, np.where(x < tail_at, body, end))
