"""Numbers made of histories that are known by heart."""

import math

import numpy as np
import pytest
import torch

from experiments.gait.diagnostics import (
    combine_seeds,
    diagnose,
    find_phase,
    lock_phases,
    measure_lean,
    trace_work,
)
from experiments.gait.histories import Histories, pick, stack
from experiments.gait.tables import write_results, write_work_table
from experiments.statistics import half_width
from fishrl.envs.stations import SafeArea

NUM, FRAMES, SHED = 40, 16, 0.625


def make_histories(*, lengths: list[int], beat: float = SHED) -> Histories:
    """Fish at x = 1.5 + 0.01 t that beat at one rate in a wake that sheds at SHED."""
    num = len(lengths)
    time = torch.arange(NUM + 1.0).double()
    fine = (1 + torch.arange(NUM * FRAMES).double()) / FRAMES
    over = [torch.arange(NUM + 1) > length for length in lengths]
    gone = torch.stack(over)
    lost = gone.repeat_interleave(FRAMES, 1)[:, FRAMES:]

    def cut(values: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        return values.expand(num, -1).masked_fill(mask, math.nan)

    place = torch.stack((cut(1.5 + 0.01 * time, gone), cut(0.0 * time, gone)), -1)
    lengths_T = torch.tensor(lengths, dtype=torch.float64)
    return Histories(
        flow=torch.zeros(num, dtype=torch.int64),
        place=place,
        frequency=cut(torch.full((NUM,), beat).double(), gone[:, 1:]),
        named=cut((time[1:] % 4 == 0).double(), gone[:, 1:]),
        angle_of_attack=cut(0.1 * torch.ones(NUM).double(), gone[:, 1:]),
        work=cut(2.0 * time, gone),
        positive_work=cut(3.0 * time, gone),
        lateral_work=cut(1.0 * time, gone),
        lengths_T=lengths_T,
        terminated=lengths_T < NUM,
        diverged=torch.zeros(num, dtype=torch.bool),
        beat=cut((2.0 * math.pi * beat * fine) % (2.0 * math.pi), lost),
        aside=cut(0.2 * torch.sin(2.0 * math.pi * SHED * fine), lost),
        lift=cut(0.7 + torch.sin(2.0 * math.pi * SHED * fine + 1.0), lost),
    )


def reduce(histories: Histories) -> dict[str, float]:
    return diagnose(
        histories, shedding_frequency=SHED, safe_area=SafeArea(far_bl=1.75), time_limit_T=NUM
    )


def test_survival_is_a_mean_with_its_interval() -> None:
    result = reduce(make_histories(lengths=[40, 40, 20, 10]))
    assert result["survival_T"] == pytest.approx(27.5)
    assert result["survivors"] == 0.5
    deviation = np.std([40, 40, 20, 10], ddof=1)
    assert result["survival_error_T"] == pytest.approx(3.182 * deviation / 2.0)
    assert result["diverged"] == 0


def test_work_adds_up_once_per_T_as_long_as_a_fish_swims() -> None:
    trace = trace_work(make_histories(lengths=[20, 9]), interval_T=0.25)  # 5 T and a little over 2
    assert trace["time_T"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert trace["work"] == [0.0, 8.0, 16.0, 24.0, 32.0, 40.0]
    assert trace["lateral_work"] == [0.0, 4.0, 8.0, 12.0, 16.0, 20.0]


def test_rates_are_per_T_of_all_episodes_together() -> None:
    result = reduce(make_histories(lengths=[40, 10]))
    assert result["work"] == pytest.approx(2.0)
    assert result["positive_work"] == pytest.approx(3.0)
    assert result["lateral_work"] == pytest.approx(1.0)
    assert result["angle_mean"] == pytest.approx(math.degrees(0.1))
    assert result["named_right"] == pytest.approx(38 / 50)  # every fourth is named wrongly


def test_an_end_is_named_after_the_nearest_border() -> None:
    result = reduce(make_histories(lengths=[40, 23]))
    assert (result["ended_far"], result["ended_near"], result["ended_aside"]) == (0.5, 0.0, 0.0)


def test_gait_needs_the_right_beat() -> None:
    assert reduce(make_histories(lengths=[40]))["in_gait"] == 1.0
    fast = reduce(make_histories(lengths=[40], beat=2.0 * SHED))
    assert (fast["in_street"], fast["in_gait"]) == (1.0, 0.0)
    assert fast["frequency_over_shedding"] == pytest.approx(2.0)


def test_a_beat_in_step_with_the_lift_is_locked_and_another_is_not() -> None:
    assert lock_phases(make_histories(lengths=[40]), SHED, frames_per_T=FRAMES) > 0.95
    assert (
        lock_phases(make_histories(lengths=[40], beat=1.25 * SHED), SHED, frames_per_T=FRAMES) < 0.5
    )
    assert math.isnan(lock_phases(make_histories(lengths=[3]), SHED, frames_per_T=FRAMES))
    assert math.isnan(lock_phases(make_histories(lengths=[40]), math.nan, frames_per_T=FRAMES))


def test_the_phase_of_a_sine_is_found() -> None:
    time = np.arange(640) / 16
    signal = 3.0 + np.cos(2.0 * np.pi * SHED * time + 0.4) + np.cos(2.0 * np.pi * 3.0 * time)
    off = np.angle(np.exp(1j * (find_phase(signal, SHED, 16) - 2.0 * np.pi * SHED * time - 0.4)))
    assert np.abs(off).max() < 1e-6


def test_frames_of_shorter_intervals_are_timed_in_periods() -> None:
    slow = make_histories(lengths=[40])._replace(lengths_T=torch.tensor([20.0]))
    result = diagnose(
        slow,
        shedding_frequency=2.0 * SHED,
        safe_area=SafeArea(),
        time_limit_T=20.0,
        interval_T=0.5,
    )
    assert result["phase_lock"] > 0.95
    assert result["sway"] == pytest.approx(0.2, rel=0.06)


def test_lean_is_what_a_swaying_body_points_off_the_stream_on_average() -> None:
    histories = make_histories(lengths=[40, 12])
    sway = 0.2 * (-1.0) ** torch.arange(NUM)
    lean = torch.where(torch.arange(NUM) < 16, 0.1, -0.05)
    histories = histories._replace(angle_of_attack=histories.angle_of_attack * 0 + lean + sway)
    rates, leans = measure_lean(histories, interval_T=1.0)
    degrees = torch.tensor([0.1, 0.1, 0.05, 0.05, 0.05, 0.1]) * 180.0 / math.pi
    torch.testing.assert_close(leans, degrees.double(), rtol=1e-6, atol=1e-6)  # 40 T, then 12
    assert rates.tolist() == pytest.approx([SHED] * 6)


def test_seeds_are_averaged_and_their_spread_is_the_error() -> None:
    one, other = (reduce(make_histories(lengths=[n])) for n in (40, 20))
    both = combine_seeds([one, other])
    assert both["survival_T"] == pytest.approx(30.0)
    assert both["survival_error_T"] == pytest.approx(half_width([40.0, 20.0]))
    assert both["episodes"] == 2
    assert combine_seeds([one])["survival_T"] == 40.0


def test_recordings_of_different_length_go_together() -> None:
    long, short = make_histories(lengths=[40]), make_histories(lengths=[10])
    cut = Histories(*(v[:, :11] if v.dim() > 1 else v for v in short))
    both = stack([long, cut])
    assert both.place.shape[0] == 2
    assert torch.equal(pick(both, torch.tensor([True, False])).place, long.place)
    assert bool(both.place[1, 11:].isnan().all())


def test_tables_have_a_row_per_fish_and_flow() -> None:
    result = reduce(make_histories(lengths=[40, 23]))
    results = {"pid": [result, result], "passive": [result, result]}
    table = write_results(results, (1.0, 1.5))
    assert len(table.splitlines()) == 2 * 6 + 1
    assert "| pid | 1.5 | 2 | 31.5 ±" in table
    assert "| passive | 1 | 50% | 0% | 50% | 0% | 0 |" in table


def test_work_is_compared_as_a_ratio_and_a_saving() -> None:
    wake = [reduce(make_histories(lengths=[40]))]
    table = write_work_table(wake, [{"work": 8.0, "positive_work": 9.0, "lateral_work": 5.0}], (1,))
    assert "| 1 | 2.000 | 8.00 | 4.0 | 75.0% | 3.0 | 1.000 | 5.00 | 5.0 | – |" in table
