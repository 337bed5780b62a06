"""Quantities derived from flows and signals: vorticity, pressure, coefficients, frequencies."""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor


def compute_vorticity(u: Tensor) -> Tensor:
    """Return dv/dx - du/dy ``[B, Y, X]`` per step of a velocity ``[B, 2, Y, X]``.

    Differences are central, at edges one-sided.
    """
    (dv_dx,) = torch.gradient(u[:, 1], dim=-1)
    (du_dy,) = torch.gradient(u[:, 0], dim=-2)
    return dv_dx - du_dy


def compute_pressure(rho: Tensor) -> Tensor:
    """Return the pressure p = (rho - 1) / 3 above that of the fluid at rest, any shape."""
    return (rho - 1.0) / 3.0


def compute_coefficient(force: Tensor, *, length: float, speed: float, rho: float = 1.0) -> Tensor:
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
    """Return where a signal ``[n]`` crosses zero upwards, in samples, interpolated linearly."""
    before, after = signal[:-1], signal[1:]
    (at,) = ((before < 0.0) & (after >= 0.0)).nonzero(as_tuple=True)
    return at + before[at] / (before[at] - after[at])


def measure_cycles(signal: Tensor, interval: float, *, clock: Tensor | None = None) -> Cycles:
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
        ValueError: if there are not two whole periods, or numbers are not finite.
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


def compute_strouhal(lift: Tensor, interval: float, *, length: float, speed: float) -> float:
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


def compute_spectral_frequency(signal: Tensor, interval: float) -> float:
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
