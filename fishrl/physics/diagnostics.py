"""Quantities derived from flows and signals: vorticity, pressure, coefficients, frequencies."""

from itertools import pairwise
from math import pi
from typing import NamedTuple

import torch
from pydantic import PositiveFloat
from torch import Tensor

from fishrl.settings import checked


@checked
def compute_vorticity(u: Tensor, *, is_water: Tensor | None = None) -> Tensor:
    """Return dv/dx - du/dy ``[B, Y, X]`` per step of a velocity ``[B, 2, Y, X]``.

    Differences are central, at edges one-sided; with ``is_water`` ``[B, Y, X]``, see
    ``InPlaceSolver.find_water``, also at skins, and NaN in bodies and between two skins.
    """
    if is_water is not None:
        known = u.masked_fill(~is_water[:, None], torch.nan)
        return _differentiate(known[:, 1], -1) - _differentiate(known[:, 0], -2)
    (dv_dx,) = torch.gradient(u[:, 1], dim=-1)
    (du_dy,) = torch.gradient(u[:, 0], dim=-2)
    return dv_dx - du_dy


def _differentiate(values: Tensor, dim: int) -> Tensor:
    """Return the mean of those differences to both neighbours that are known, else NaN."""
    unknown = torch.full_like(values.narrow(dim, 0, 1), torch.nan)
    step = values.diff(dim=dim)
    sides = torch.cat((step, unknown), dim), torch.cat((unknown, step), dim)
    return torch.stack(sides).nanmean(0)


def compute_pressure(rho: Tensor) -> Tensor:
    """Return the pressure p = (rho - 1) / 3 above that of the fluid at rest, any shape."""
    return (rho - 1.0) / 3.0


@checked
def compute_coefficient(
    force: Tensor, *, length: PositiveFloat, speed: PositiveFloat, rho: PositiveFloat = 1.0
) -> Tensor:
    """Return 2 F / (rho U^2 D): drag or lift coefficient of a force per unit depth.

    Args:
        force: on the body, any shape, lattice units.
        length: D in nodes.
        speed: U in nodes per step.
        rho: density of the stream.
    """
    return 2.0 * force / (rho * speed * speed * length)


class Cycles(NamedTuple):
    """Statistics of a signal over whole periods."""

    frequency: float  #: periods per unit of time, from its zero crossings
    num_cycles: int  #: number of periods
    mean: float  #: over whole periods
    rms: float  #: root mean square deviation from the mean
    low: float  #: mean of the periods' minima
    high: float  #: mean of the periods' maxima

    @property
    def amplitude(self) -> float:
        """Half the height from trough to crest."""
        return 0.5 * (self.high - self.low)


def find_crossings(signal: Tensor) -> Tensor:
    """Return where a signal ``[n]`` crosses zero upwards, in samples, interpolated linearly.

    Noise crosses many times: all crossings between a sample below a band around zero and the next
    one above it count as one, in the middle between the first and the last. The band is four
    standard deviations of the noise wide to each side, at most 0.7 of the signal's. Where the
    record begins or ends within it, its sign counts.
    """
    before, after = signal[:-1], signal[1:]
    (at,) = ((before < 0.0) & (after >= 0.0)).nonzero(as_tuple=True)
    place = at + before[at] / (before[at] - after[at])
    side = torch.where(signal < 0.0, -1, 1)
    band = (4.0 * _measure_noise(signal)).clamp(max=0.7) * signal.std()
    is_outside = signal.abs() > band
    is_outside[[0, -1]] = True
    (outside,) = is_outside.nonzero(as_tuple=True)
    rises = (side[outside[:-1]] < 0) & (side[outside[1:]] > 0)
    first = place[torch.searchsorted(at, outside[:-1][rises])]
    last = place[torch.searchsorted(at, outside[1:][rises]) - 1]
    return 0.5 * (first + last)


def _measure_noise(signal: Tensor) -> Tensor:
    """Return the standard deviation of noise, in that of the signal ``[n]``.

    Third differences of white noise have 20 times its variance, those of a smooth signal little.
    """
    return signal.diff(n=3).square().mean().div(20.0).sqrt() / signal.std()


@checked
def measure_cycles(
    signal: Tensor, interval: PositiveFloat, *, clock: Tensor | None = None
) -> Cycles:
    """Measure a periodic signal over its whole periods.

    A period runs from one upward crossing of the clock's mean to the next. The mean, too, is taken
    over whole periods, so that a partial period does not shift it. Extremes are interpolated by
    parabolas through three samples.

    Args:
        signal: ``[n]`` evenly sampled.
        interval: time between samples.
        clock: ``[n]`` signal that defines the periods, such as the lift for the drag, which has two
            periods in one of the lift; ``signal`` itself by default.

    Raises:
        ValueError: if there are not two whole periods, if the clock drifts or its spectrum is not
            strongest about the frequency of its crossings, or if numbers are not finite.
    """
    values = signal.double()
    beat = values if clock is None else clock.double()
    _check_finite(values)
    _check_finite(beat)
    at = find_crossings(beat - beat.mean())
    for _ in range(3):  # the mean over whole periods moves the crossings a little
        _check_periods(at, signal)
        at = find_crossings(beat - _integrate(beat, at[0], at[-1]) / (at[-1] - at[0]))
    _check_periods(at, signal)
    _check_oscillation(beat, at)
    first, last, num = at[0], at[-1], len(at) - 1
    mean = _integrate(values, first, last) / (last - first)
    square = _integrate((values - mean) ** 2, first, last) / (last - first)
    ends = [int(x) for x in at.round().tolist()]
    parts = [values[max(a - 1, 0) : b + 2] for a, b in pairwise(ends)]
    highs, lows = [find_peak(part) for part in parts], [-find_peak(-part) for part in parts]
    return Cycles(
        frequency=float(num / ((last - first) * interval)),
        num_cycles=num,
        mean=float(mean),
        rms=float(square.sqrt()),
        low=sum(lows) / num,
        high=sum(highs) / num,
    )


@checked
def compute_strouhal(
    lift: Tensor, interval: PositiveFloat, *, length: PositiveFloat, speed: PositiveFloat
) -> float:
    """Return f D / U from the zero crossings of the lift.

    Args:
        lift: ``[n]`` evenly sampled, in any unit.
        interval: steps between samples.
        length: D in nodes.
        speed: U in nodes per step.

    Raises:
        ValueError: as ``measure_cycles``.
    """
    return measure_cycles(lift, interval).frequency * length / speed


@checked
def compute_spectral_frequency(signal: Tensor, interval: PositiveFloat) -> float:
    """Return the frequency of the strongest line of a signal's spectrum.

    Hann window; between bins, the frequency is interpolated by a parabola through the logarithm of
    three bins, accurate to about 1 % of a bin.

    Args:
        signal: ``[n]`` evenly sampled.
        interval: time between samples.

    Raises:
        ValueError: for fewer than four samples, or numbers that are not finite.
    """
    if len(signal) < 4:
        raise ValueError(f"{len(signal)} samples have no spectrum: at least four are needed")
    _check_finite(signal)
    values = signal.double() - signal.double().mean()
    window = torch.hann_window(len(values), periodic=True, dtype=torch.float64)
    power = torch.fft.rfft(values * window.to(values.device)).abs().clamp_min(1e-300).log()
    at = int(power[1:-1].argmax()) + 1
    return (at + _fit_peak(power, at)[0]) / (len(values) * interval)


def _check_periods(crossings: Tensor, signal: Tensor) -> None:
    if len(crossings) < 3:
        raise ValueError(
            f"{len(signal)} samples hold {max(len(crossings) - 1, 0)} whole periods: measure "
            "longer, at least two are needed"
        )


def _check_oscillation(clock: Tensor, crossings: Tensor) -> None:
    """Raise ValueError unless a clock ``[n]`` oscillates as its upward crossings say.

    A quarter of its power, and twice as much as of white noise, must lie within a quarter of their
    frequency. Noise of 0.15 amplitudes passes, and none of 0.2; a sine of few samples per period
    looks like noise. The means of the two halves must differ by less than 0.3 amplitudes.
    """
    first, middle, last = crossings[0], crossings[len(crossings) // 2], crossings[-1]
    frequency, bin_width = (len(crossings) - 1) / (last - first), 1.0 / len(clock)
    window = torch.hann_window(len(clock), periodic=True, dtype=clock.dtype, device=clock.device)
    power = torch.fft.rfft((clock - clock.mean()) * window).abs().square()
    distance = (torch.arange(len(power), device=clock.device) * bin_width - frequency).abs()
    reach = 0.25 * frequency + 2.0 * bin_width
    share = power[distance <= reach].sum() / power.sum()
    least = (4.0 * reach / 0.5).clamp(0.25, 0.75)
    halves = [_integrate(clock, a, b) / (b - a) for a, b in ((first, middle), (middle, last))]
    drift = (halves[1] - halves[0]).abs() / (2.0**0.5 * clock.std())
    noise = _measure_noise(clock) - (2.0 * pi * frequency) ** 3
    for is_wrong, reason in (
        (not share >= least, "noise, or several frequencies: measure longer"),
        (not noise <= 0.23, "noise: smooth it, as by a mean over neighbouring samples"),
        (not drift <= 0.3, "it drifts: leave out the beginning, or subtract the trend"),
    ):
        if is_wrong:
            raise ValueError(f"the signal is no steady oscillation ({reason})")


def _check_finite(signal: Tensor) -> None:
    if not signal.isfinite().all():
        raise ValueError("some samples are not finite: the flow has diverged")


def _integrate(values: Tensor, start: Tensor, end: Tensor) -> Tensor:
    """Return the integral of the line through samples from ``start`` to ``end``, in samples."""
    total = torch.cat((values[:1] * 0.0, torch.cumsum(0.5 * (values[1:] + values[:-1]), 0)))

    def until(x: Tensor) -> Tensor:
        i = int(min(int(x), len(values) - 2))
        part = x - i
        return total[i] + part * (values[i] + 0.5 * part * (values[i + 1] - values[i]))

    return until(end) - until(start)


def find_peak(values: Tensor) -> float:
    """Return the largest of even samples ``[n]``, by a parabola if it is not the first or last."""
    at = int(values.argmax())
    return float(values[at]) if at in (0, len(values) - 1) else _fit_peak(values, at)[1]


def _fit_peak(values: Tensor, at: int) -> tuple[float, float]:
    """Return place (from ``at``) and height of the parabola through a sample and its neighbours."""
    before, here, after = values[at - 1 : at + 2].tolist()
    bend = before - 2.0 * here + after
    if not bend:
        return 0.0, here
    return 0.5 * (before - after) / bend, here - (after - before) ** 2 / (8.0 * bend)
