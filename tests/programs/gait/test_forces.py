"""The phase of thrust of a held fish."""

from math import cos, isfinite, pi, radians

import numpy as np
import pytest

from experiments.gait_forces import compare_phases, find_thrust_phase


def test_lift_and_beat_are_compared_at_the_same_times() -> None:
    period, every = 160.0, 10
    time = np.arange(0.0, 8.0 * period + 1.0, every)[None]
    rate = 2.0 * pi / period
    lift = -np.cos(rate * time + 0.7) / rate  # impulse of a force of phase 0.7 in sines
    beat = (rate * time + pi / 2.0) % (2.0 * pi)  # ``find_phase`` is that of a cosine
    found = compare_phases(lift, beat, np.ones(1), interval=every, shedding=1.0 / period)
    assert np.angle(found) == pytest.approx(0.7 - pi, abs=0.01)
    assert np.abs(found) == pytest.approx(1.0, abs=0.01)


def test_the_phase_of_thrust_is_that_of_a_sine_through_the_forces() -> None:
    lags = [radians(angle) for angle in (-110.0, -20.0, 70.0, 160.0)]
    rows = [{"lag": lag, "lock": 1.0, "force_x": 0.01 - 0.05 * cos(lag - 2.0)} for lag in lags]
    assert find_thrust_phase(rows) == pytest.approx(2.0)
    alike = [row | {"lag": 0.1 * row["lag"]} for row in rows]
    assert not isfinite(find_thrust_phase(alike))
