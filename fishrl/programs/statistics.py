"""Statistics over seeds and starts: means, interquartile means, improvement; 95 % intervals.

The interquartile mean and the probability of improvement are those of Agarwal et al. 2021 (arXiv
2108.13264, section 4.3), with percentile bootstrap intervals over six seeds or more. SciPy, which
takes a second to import, is imported by the functions that need it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

#: Values below which no bootstrap interval is given: it would be far too narrow.
FEWEST = 6


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An estimate and its 95 % interval, of NaN where there are too few values."""

    value: float
    low: float
    high: float

    def show(self, form: str) -> str:
        """Format as "+1.5 [-0.5, +3.5]"; a dash for NaN."""
        if math.isnan(self.value):
            return "–"
        value = format(self.value, form)
        return value if math.isnan(self.low) else f"{value} [{self.low:{form}}, {self.high:{form}}]"


def show(value: float, form: str, error: float = math.nan) -> str:
    """Write a number, with its error where there is one, or a dash for NaN."""
    if math.isnan(value):
        return "–"
    return format(value, form) + ("" if math.isnan(error) else f" ± {error:{form.lstrip('+')}}")


def half_width(values: Sequence[float]) -> float:
    """Return half the width of a mean's interval (Student's t); NaN below two values."""
    if len(values) < 2:
        return math.nan
    from scipy import stats

    return float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))


def find_mean(values: Sequence[float]) -> Interval:
    """Return the mean of the values that are not NaN; without any, everything is NaN."""
    known = [value for value in values if not math.isnan(value)]
    mean, half = float(np.mean(known)) if known else math.nan, half_width(known)
    return Interval(value=mean, low=mean - half, high=mean + half)


def find_share(successes: int, total: int) -> Interval:
    """Return a proportion with Wilson's interval, which lies within 0 and 1."""
    from scipy import stats

    interval = stats.binomtest(successes, total).proportion_ci(method="wilson")
    return Interval(value=successes / total, low=interval.low, high=interval.high)


def find_interquartile_mean(values: Sequence[float]) -> Interval:
    """Return the mean of the middle half; NaN without values.

    A quarter of the values, rounded down, is left out at either end; below four values it is the
    plain mean.
    """
    from scipy import stats

    return _bootstrap(partial(stats.trim_mean, proportiontocut=0.25), values)


def find_improvement(ours: Sequence[float], theirs: Sequence[float]) -> Interval:
    """Return the probability that a run of ours exceeds one of theirs; ties count half.

    Runs are drawn with replacement within each group. NaN unless both have runs.
    """

    def compare(a: Any, b: Any, axis: int = -1) -> Any:
        difference = a[..., :, None] - b[..., None, :]
        return (0.5 * np.sign(difference) + 0.5).mean((-2, -1))

    return _bootstrap(compare, ours, theirs)


def _bootstrap(statistic: Any, *groups: Sequence[float]) -> Interval:
    if not all(groups):
        return Interval(value=math.nan, low=math.nan, high=math.nan)
    samples = [np.asarray(group, dtype=float) for group in groups]
    value = float(statistic(*samples))
    if min(map(len, groups)) < FEWEST:
        return Interval(value=value, low=math.nan, high=math.nan)
    from scipy import stats

    interval = stats.bootstrap(
        samples, statistic, vectorized=True, method="percentile", n_resamples=2000, rng=0
    ).confidence_interval
    return Interval(value=value, low=float(interval.low), high=float(interval.high))
