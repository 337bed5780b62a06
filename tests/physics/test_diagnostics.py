"""What is read off signals and fields."""

import math

import pytest
import torch

from fishrl.physics.diagnostics import (
    average_periods,
    compute_pressure,
    find_crossings,
    find_period,
)

TIME = torch.arange(1000, dtype=torch.float64)


def test_the_period_of_a_sine_is_found_between_the_samples() -> None:
    signal = 0.3 + 2.0 * torch.sin(2 * math.pi * TIME / 37.3)
    assert float(find_period(signal)) == pytest.approx(37.3, rel=1e-3)
    assert float(find_crossings(torch.sin(2 * math.pi * (TIME - 5.5) / 100))[0]) == pytest.approx(
        5.5, abs=0.01
    )


def test_a_mean_over_whole_periods_does_not_depend_on_where_the_record_ends() -> None:
    for end in (640, 700, 990):
        signal = 0.3 + 2.0 * torch.sin(2 * math.pi * TIME[:end] / 50 + 0.4)
        assert float(average_periods(signal)) == pytest.approx(0.3, abs=0.02)


def test_a_signal_without_a_period_is_refused() -> None:
    with pytest.raises(ValueError, match="rises through its mean 0 times"):
        find_period(torch.linspace(1.0, 0.0, 50))


def test_pressure_is_zero_at_rest() -> None:
    assert compute_pressure(torch.tensor([1.0, 1.03])).tolist() == pytest.approx([0.0, 0.01])
