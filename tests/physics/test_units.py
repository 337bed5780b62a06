"""Lattice units: what follows from a preset."""

import math

import pytest

from fishrl.physics import CARANGIFORM, CARLING, Gait
from fishrl.physics.units import Scales, compute_tau


def test_budget_keeps_reynolds_number_and_bounds_beat_and_stream() -> None:
    scales = Scales.from_budget(body_length=50, reynolds=7000.0, max_wall_speed=0.07)
    assert scales.period % 2 == 0
    assert scales.body_length**2 / (scales.nu * scales.period) == pytest.approx(7000.0)
    assert 0.0697 < scales.tail_speed <= 0.07
    assert scales.reference_speed == pytest.approx(50 / scales.period)
    beat = Scales.from_budget(body_length=50, reynolds=500.0, max_frequency=1.6)
    assert 0.0697 < beat.tail_speed <= 0.07
    stream = Scales.from_budget(body_length=50, reynolds=500.0, stream_speed_bl=1.5)
    assert 0.0697 < stream.stream_speed <= 0.07
    assert stream.tail_speed < 0.04
    assert stream.mach == pytest.approx(stream.stream_speed * 3**0.5)
    rounded = {"body_length": 20, "reynolds": 500.0, "stream_speed_bl": 1.5}
    limit = Scales.from_budget(**rounded, max_wall_speed=0.15)
    assert limit.period == 200
    assert limit.stream_speed == pytest.approx(0.15, rel=1e-12)


def test_relaxation_times_of_the_paper_follow_from_its_reynolds_numbers() -> None:
    """L = 100, T = 600 of Task 1; D = 40, U = 0.1, Re = 200 of Task 2."""
    scales = Scales(body_length=100, reynolds=7000.0, period=600)
    assert scales.tau == pytest.approx(0.50714, abs=1e-5)
    assert compute_tau(length=40, speed=0.1, reynolds=200) == pytest.approx(0.56)


@pytest.mark.parametrize(
    ("gait", "largest"),
    [
        (CARLING, 0.125),
        (CARANGIFORM, 0.1),
        (Gait(amplitude=0.1, envelope=(1.0, -0.5, 0.0), wavenumber=2.0), 0.1),  # at the head
        (Gait(amplitude=0.1, envelope=(0.0, -4.0, 4.0), wavenumber=2.0), 0.1),  # in the middle
    ],
)
def test_fastest_point_of_the_midline_sets_the_gait_speed(gait: Gait, largest: float) -> None:
    assert gait.tail_speed == pytest.approx(2.0 * math.pi * largest, rel=1e-12)
