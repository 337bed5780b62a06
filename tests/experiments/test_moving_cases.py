"""Evaluation of validation cases with moving bodies."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from experiments.validation import sheared_ellipse, slip
from experiments.validation.invariance import BASE, MIRRORED, compare
from experiments.validation.oscillating_cylinder import fit_force
from fishrl.physics import ImmersedBoundary
from fishrl.physics.flow import make_params
from fishrl.physics.step import step


def test_force_fit_finds_drag_and_added_mass() -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 50, endpoint=False)
    v, a = np.cos(phase), -1.7 * np.sin(phase)
    force = -0.5 * 2.1 * np.abs(v) * v - 0.25 * np.pi * 1.45 * a
    assert fit_force(force, v, a) == pytest.approx((2.1, 1.45))


def test_period_is_extrapolated_to_infinite_gap() -> None:
    periods = {gap: 15.0 + 9.0 / gap**2 for gap in sheared_ellipse.GAPS}
    assert sheared_ellipse.extrapolate(periods) == pytest.approx(15.0)


def test_mirrored_vector_is_compared_with_image() -> None:
    run = {BASE: [3.0, 4.0], MIRRORED: [3.0, -4.0], "shifted": [3.0, 4.5]}
    assert compare(run, None, is_speed=False) == {MIRRORED: 0.0, "shifted": 0.1}


def test_measured_slip_equals_reported_slip() -> None:
    config, state, speed, _ = slip.make_fish_flow()
    params = make_params([config])
    for _ in range(20):
        state = step(state, config, params)
    measured = slip.measure_slip(state, config, params)
    reported = float(step(state, config, params).bodies[0].slip_error)
    assert reported > 1e-6
    torch.testing.assert_close(measured, reported, rtol=1e-9, atol=0.0)
    exact = replace(config, skin=ImmersedBoundary(force_solve=slip.EXACT))
    for dtype, limit in ((torch.float64, 1e-12), (torch.float32, 1e-6)):
        rounded = state._replace(f=state.f.to(dtype))
        assert slip.measure_slip(rounded, exact, params) < limit * speed
