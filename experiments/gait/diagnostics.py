"""Diagnostics of station holding: survival, position, gait, phase locking and work."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from experiments.gait.trials import WORKS, Histories
from fishrl.envs import KarmanGait
from fishrl.programs.statistics import half_width

#: Nose positions (x behind the flat side, |y|), body lengths, inside the vortex street.
STREET = ((0.8, 3.0), 0.5)
#: Work in the results: that in ``WORKS``, and of muscles and torque together on the water.
BALANCE = (*WORKS, "total_work")
#: Largest relative difference from the shedding frequency that counts as Kármán gait.
GAIT_BAND = 0.25


def diagnose(
    histories: Histories, task: KarmanGait, *, shedding_frequency: float
) -> dict[str, float]:
    """Reduce the episodes of one policy in one flow to numbers; NaN where there is no data.

    ``survival_T`` is the mean over all episodes, a diverged one counting until then, with the
    half-width ``survival_error_T`` of its 95 % interval; ``survivors`` lasted and did not diverge.
    Shares are of all episodes (``survivors``), of the intervals (``in_street``: nose in ``STREET``;
    ``in_gait``: and beating within ``GAIT_BAND`` of the shedding frequency), or of the decisions
    (``named_right``: correct flow label). Lengths are in L, angles in degrees, frequencies per T,
    work per T in rho L^2 (L / T)^2. The shedding frequency is that of the wake without a fish, NaN
    in a free stream.
    """
    h, lengths = histories, histories.lengths_T.double()
    x, y = h.place[:, 1:, 0], h.place[:, 1:, 1]
    (near, far), aside = STREET
    is_known = ~h.frequency.isnan()
    in_street = (x >= near) & (x <= far) & (y.abs() <= aside) & is_known
    ratio = h.frequency / shedding_frequency
    in_gait = in_street & ((ratio - 1.0).abs() <= GAIT_BAND)
    frames_per_T = max(1, h.beat.shape[1] // max(1, h.frequency.shape[1])) / task.interval_T
    angle = h.angle_of_attack.abs() * 180.0 / math.pi
    total_T = max(float(h.lengths_T.sum()), 1e-9)
    works = zip(BALANCE, list_works(h), strict=True)
    last = (~h.work.isnan()).sum(1, keepdim=True).clamp_min(1) - 1
    return {
        "episodes": len(h.flow),
        "diverged": int(h.diverged.sum()),
        "survival_T": _mean(lengths),
        "survival_error_T": half_width(lengths.tolist()),
        "survivors": _mean((~h.terminated & ~h.diverged).double()),
        "x_mean": _mean(x),
        "frequency": _mean(h.frequency),
        "frequency_over_shedding": _mean(ratio),
        "in_street": _share(in_street, is_known),
        "in_gait": _share(in_gait, is_known & ~ratio.isnan()),
        "angle_mean": _mean(angle),
        "angle_max": float(angle.nan_to_num(0.0).max()),
        "phase_lock": lock_phases(h, shedding_frequency, frames_per_T=frames_per_T),
        **{name: float(values.gather(1, last).nansum()) / total_T for name, values in works},
        "named_right": _share(h.named == h.flow[:, None], ~h.named.isnan() & is_known),
    }


def list_works(histories: Histories) -> list[Tensor]:
    """Return the series ``[E, N + 1]`` of ``BALANCE``."""
    parts = [getattr(histories, name) for name in WORKS]
    return [*parts, histories.work + histories.torque_work]


def trace_work(histories: Histories, *, interval_T: float) -> dict[str, list[float]]:
    """Return ``work``, ``torque_work``, ``lateral_work`` since the start once per T (``time_T``).

    Means over the episodes of one flow that still run, in rho L^2 (L / T)^2.
    """
    every = max(1, round(1.0 / interval_T))
    names = ("work", "torque_work", "lateral_work")
    means = {name: getattr(histories, name)[:, ::every].double().nanmean(0) for name in names}
    runs = ~means["work"].isnan()
    times = interval_T * every * torch.arange(len(runs), dtype=torch.float64)
    return {name: series[runs].tolist() for name, series in {"time_T": times, **means}.items()}


def lock_phases(histories: Histories, shedding_frequency: float, *, frames_per_T: float) -> float:
    """Return the phase locking of the tail beat to the lift on the obstacle, 0 to 1.

    Length of the mean of exp(i (beat - shed)) over windows of 8 T, averaged over those; shed is
    the phase of the lift near the shedding frequency. Two unrelated phases give about 0.2 here.
    """
    if math.isnan(shedding_frequency):
        return math.nan
    window, first = round(8 * frames_per_T), round(frames_per_T)
    locks: list[float] = []
    for beat, lift in zip(histories.beat, histories.lift, strict=True):
        known = ~beat.isnan()
        if int(known.sum()) < window + first:
            continue
        phases, force = (row[known][first:].double().numpy() for row in (beat, lift))
        apart = np.exp(1j * (phases - find_phase(force, shedding_frequency, frames_per_T)))
        blocks = apart[: len(apart) // window * window].reshape(-1, window)
        locks += np.abs(blocks.mean(1)).tolist()
    return float(np.mean(locks)) if locks else math.nan


def find_phase(signal: NDArray[np.float64], frequency: float, rate: float) -> NDArray[np.float64]:
    """Return the phase of signals ``[..., n]``, ``rate`` samples per time, near a frequency.

    It is the phase of the analytic signal (Hilbert transform) of the band from 0.5 to 1.5 times the
    frequency.
    """
    spectrum = np.fft.fft(signal - signal.mean(-1, keepdims=True))
    at = np.fft.fftfreq(signal.shape[-1], 1.0 / rate)
    spectrum[..., (at < 0.5 * frequency) | (at > 1.5 * frequency)] = 0.0
    return np.asarray(np.angle(np.fft.ifft(spectrum)))


def combine_seeds(results: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Average the numbers of several seeds; ``survival_error_T`` becomes that over the seeds."""
    if len(results) == 1:
        return dict(results[0])
    mean = {name: _mean(torch.tensor([float(r[name]) for r in results])) for name in results[0]}
    mean["survival_error_T"] = half_width([result["survival_T"] for result in results])
    mean["angle_max"] = max(result["angle_max"] for result in results)
    for name in ("episodes", "diverged"):
        mean[name] = sum(result[name] for result in results)
    return mean


def _mean(values: Tensor) -> float:
    return float(values[~values.isnan()].double().mean())


def _share(flag: Tensor, of: Tensor) -> float:
    return float((flag & of).sum() / of.sum()) if bool(of.any()) else math.nan
