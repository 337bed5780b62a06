"""The examples of gradients through the water, on short motions."""

from importlib.util import find_spec

import pytest
import torch
from torch import Tensor

from examples.gradient_design import PUBLISHED, SEARCHES, Escape, Exhausted, Meter, scan
from examples.gradient_horizon import Horizon
from examples.gradient_inverse import GUESS, Recording, fit
from fishrl.physics.flow import make_rest

ESCAPE = Escape(duration_T=0.02, penalty=0.0, compile=False)


def test_fit_finds_frequency_and_amplitude_of_a_recording() -> None:
    recording = Recording(periods=0.1, times=2, compile=False)
    with torch.no_grad():
        data = recording.swim(torch.ones(1, 3).double())
    course, slopes = fit(recording, data, 2)
    assert slopes.shape == (1, 14, 3)
    errors = (course - 1.0).abs()
    assert torch.equal(course[0, 0], torch.tensor(GUESS).double())
    assert (errors[-1, 0, 1:] < 0.5 * errors[0, 0, 1:]).all()
    assert (course[1:] / course[:-1]).log().abs().max() < 0.3001  # the limit of a step


@pytest.mark.parametrize("name", SEARCHES)
def test_searches_use_their_budget_and_find_better_strokes(name: str) -> None:
    meter = Meter(ESCAPE, 9 * ESCAPE.num_steps)
    if name == "CMA-ES" and find_spec("cmaes") is None:
        with pytest.raises(ImportError, match="pip install cmaes"):
            SEARCHES[name](meter, PUBLISHED, 0)
        return
    with pytest.raises(Exhausted):
        SEARCHES[name](meter, PUBLISHED, 0)
    assert 7 * ESCAPE.num_steps < meter.steps <= meter.budget
    assert meter.course[-1][1] > meter.course[0][1]
    assert ((meter.best >= 0.0) & (meter.best <= 1.0)).all()


def test_gradient_is_the_slope_of_the_scan() -> None:
    shifts, distances, slope = scan(ESCAPE, 5)
    secant = (distances[3] - distances[1]) / (shifts[3] - shifts[1])
    assert slope == pytest.approx(secant, rel=0.1)


@pytest.mark.slow
def test_gradient_predicts_a_small_change_of_a_beat_in_still_water() -> None:
    horizon = Horizon(periods=1, travels=1.0, compile=False)
    (wake,) = horizon.develop_wakes(1)
    rest: Tensor = make_rest(horizon.config, 1, torch.float32)
    assert wake.shape == rest.shape
    slope, secants = horizon.compare(rest, 0.0)
    assert secants.shape == (2, 2)
    torch.testing.assert_close(secants[:, 0], slope, rtol=0.05, atol=0.0)
