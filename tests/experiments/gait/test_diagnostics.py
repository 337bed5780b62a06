"""Diagnostics of synthetic histories whose numbers are known."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from experiments.gait.diagnostics import BALANCE, combine_seeds, diagnose, find_phase, trace_work
from experiments.gait.trials import Histories
from fishrl.programs.statistics import half_width

NUM, FRAMES, SHED = 40, 16, 0.625


def make_histories(*, lengths: list[int], beat: float = SHED) -> Histories:
    """Fish at x = 1.5 + 0.01 t that beat at one rate in a wake that sheds at SHED."""
    time = torch.arange(NUM + 1.0).double()
    fine = (1 + torch.arange(NUM * FRAMES).double()) / FRAMES
    lengths_T = torch.tensor(lengths, dtype=torch.float64)
    gone = time > lengths_T[:, None]
    lost = gone.repeat_interleave(FRAMES, 1)[:, FRAMES:]

    def cut(values: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        return values.expand(len(lengths), -1).masked_fill(mask, math.nan)

    return Histories(
        flow=torch.zeros(len(lengths), dtype=torch.int64),
        place=torch.stack((cut(1.5 + 0.01 * time, gone), cut(0.0 * time, gone)), -1),
        frequency=cut(torch.full((NUM,), beat).double(), gone[:, 1:]),
        named=cut((time[1:] % 4 == 0).double(), gone[:, 1:]),
        angle_of_attack=cut(0.1 * torch.ones(NUM).double(), gone[:, 1:]),
        work=cut(2.0 * time, gone),
        positive_work=cut(3.0 * time, gone),
        lateral_work=cut(1.0 * time, gone),
        torque_work=cut(-0.5 * time, gone),
        lengths_T=lengths_T,
        terminated=lengths_T < NUM,
        diverged=torch.zeros(len(lengths), dtype=torch.bool),
        beat=cut((2.0 * math.pi * beat * fine) % (2.0 * math.pi), lost),
        lift=cut(0.7 + torch.sin(2.0 * math.pi * SHED * fine + 1.0), lost),
    )


def reduce(histories: Histories, *, shed: float = SHED, interval_T: float = 1.0) -> dict[str, Any]:
    task: Any = SimpleNamespace(time_limit=NUM, interval_T=interval_T)
    return diagnose(histories, task, shedding_frequency=shed)


def test_survival_has_mean_and_interval() -> None:
    result = reduce(make_histories(lengths=[40, 40, 20, 10]))
    assert result["survival_T"] == pytest.approx(27.5)
    assert result["survivors"] == 0.5
    lost = make_histories(lengths=[40, 40])._replace(terminated=torch.tensor([True, False]))
    assert reduce(lost)["survivors"] == 0.5  # one left the safe area in the last decision
    rounded = make_histories(lengths=[40, 40])._replace(lengths_T=torch.tensor([39.9999, 40.0]))
    assert reduce(rounded)["survivors"] == 1.0
    deviation = np.std([40, 40, 20, 10], ddof=1)
    assert result["survival_error_T"] == pytest.approx(3.182 * deviation / 2.0, rel=1e-3)
    assert result["diverged"] == 0


def test_work_is_traced_per_T_until_last_episode_ends() -> None:
    trace = trace_work(make_histories(lengths=[20, 9]), interval_T=0.25)  # 5 T and a little over 2
    assert trace["time_T"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert trace["work"] == [0.0, 8.0, 16.0, 24.0, 32.0, 40.0]
    assert trace["lateral_work"] == [0.0, 4.0, 8.0, 12.0, 16.0, 20.0]


def test_rates_pool_all_episodes() -> None:
    result = reduce(make_histories(lengths=[40, 10]))
    assert [result[name] for name in BALANCE] == [2.0, 3.0, 1.0, -0.5, 1.5]
    assert result["angle_mean"] == pytest.approx(math.degrees(0.1))
    assert result["named_right"] == pytest.approx(38 / 50)  # every fourth is named wrongly


def test_gait_requires_a_beat_near_the_shedding_frequency() -> None:
    assert reduce(make_histories(lengths=[40]))["in_gait"] == 1.0
    fast = reduce(make_histories(lengths=[40], beat=2.0 * SHED))
    assert (fast["in_street"], fast["in_gait"]) == (1.0, 0.0)
    assert fast["frequency_over_shedding"] == pytest.approx(2.0)


def test_phase_lock_needs_beat_in_phase_with_lift() -> None:
    assert reduce(make_histories(lengths=[40]))["phase_lock"] > 0.95
    assert reduce(make_histories(lengths=[40], beat=1.25 * SHED))["phase_lock"] < 0.5
    assert math.isnan(reduce(make_histories(lengths=[3]))["phase_lock"])
    assert math.isnan(reduce(make_histories(lengths=[40]), shed=math.nan)["phase_lock"])
    time = np.arange(640) / 16
    signal = 3.0 + np.cos(2.0 * np.pi * SHED * time + 0.4) + np.cos(2.0 * np.pi * 3.0 * time)
    off = np.angle(np.exp(1j * (find_phase(signal, SHED, 16) - 2.0 * np.pi * SHED * time - 0.4)))
    assert np.abs(off).max() < 1e-6


def test_frames_of_shorter_intervals_are_timed_in_T() -> None:
    slow = make_histories(lengths=[40])._replace(lengths_T=torch.tensor([20.0]))
    result = reduce(slow, shed=2.0 * SHED, interval_T=0.5)
    assert result["phase_lock"] > 0.95


def test_interval_is_over_seeds() -> None:
    both = combine_seeds([reduce(make_histories(lengths=[n])) for n in (40, 20)])
    assert both["survival_T"] == pytest.approx(30.0)
    assert both["survival_error_T"] == pytest.approx(half_width([40.0, 20.0]))
    assert both["episodes"] == 2
