"""Means over seeds: 95 % confidence intervals (Student's t) and interquartile means."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: Student's t at 97.5 % by degrees of freedom; in between it is smooth in their inverse.
_FREEDOM = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 20, 30, 60, 120, math.inf)
_STUDENT_95 = (
    *(12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306),
    *(2.262, 2.228, 2.131, 2.086, 2.042, 2.000, 1.980, 1.960),
)


@dataclass(frozen=True, kw_only=True)
class Statistic:
    """One number over several seeds: count, mean, half-width of its interval, IQM."""

    count: int
    mean: float
    half_width: float
    iqm: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Statistic:
        """Reduce some values; without any, everything is NaN."""
        mean = float(np.mean(values)) if values else math.nan
        half, iqm = half_width(values), interquartile_mean(values)
        return cls(count=len(values), mean=mean, half_width=half, iqm=iqm)

    def show(self, form: str) -> str:
        """Write mean ± half width, each in a format such as ``.1%``; a dash without values."""
        if math.isnan(self.mean):
            return "–"
        mean = format(self.mean, form)
        return mean if math.isnan(self.half_width) else f"{mean} ± {self.half_width:{form}}"


def half_width(values: Sequence[float]) -> float:
    """Return half the width of the 95 % confidence interval of a mean; NaN below two values."""
    count = len(values)
    if count < 2:
        return math.nan
    inverse = [1.0 / freedom for freedom in reversed(_FREEDOM)]
    factor = float(np.interp(1.0 / (count - 1), inverse, _STUDENT_95[::-1]))
    return factor * float(np.std(values, ddof=1)) / math.sqrt(count)


def interquartile_mean(values: Sequence[float]) -> float:
    """Return the mean of the middle half, Agarwal et al. 2021 (arXiv 2108.13264, section 4.3).

    A quarter of the values, rounded down, is left out at either end, as there; below four values
    it is the plain mean. NaN without values.
    """
    if not values:
        return math.nan
    cut = len(values) // 4
    return float(np.mean(sorted(values)[cut : len(values) - cut]))


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of two means, with its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, ours: np.ndarray, theirs: np.ndarray, *, num_draws: int = 10_000) -> Difference:
        """Compare values ``[seeds, starts]``; the starts are the same, the seeds need not be.

        Starts are drawn for both together, seeds for each, all with replacement (Efron 1979).
        """
        draw = np.random.default_rng(0)

        def sample(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
            seeds = draw.integers(len(values), size=(num_draws, len(values)))
            return values[seeds[:, :, None], starts[:, None, :]].mean((1, 2))

        starts = draw.integers(ours.shape[1], size=(num_draws, ours.shape[1]))
        low, high = np.quantile(sample(ours, starts) - sample(theirs, starts), (0.025, 0.975))
        mean = float(ours.mean() - theirs.mean())
        return cls(mean=mean, low=float(low), high=float(high))

    def show(self, form: str) -> str:
        """Write it such as "+1.5 [-0.5, +3.5]"."""
        return f"{self.mean:{form}} [{self.low:{form}}, {self.high:{form}}]"
