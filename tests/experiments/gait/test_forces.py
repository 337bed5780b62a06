"""The phase of thrust of a held fish."""

from math import cos, isfinite, radians

import pytest

from experiments.gait_forces import find_thrust_phase


def test_the_phase_of_thrust_is_that_of_a_sine_through_the_forces() -> None:
    lags = [radians(angle) for angle in (-110.0, -20.0, 70.0, 160.0)]
    rows = [{"lag": lag, "lock": 1.0, "force_x": 0.01 - 0.05 * cos(lag - 2.0)} for lag in lags]
    assert find_thrust_phase(rows) == pytest.approx(2.0)
    alike = [row | {"lag": 0.1 * row["lag"]} for row in rows]
    assert not isfinite(find_thrust_phase(alike))
