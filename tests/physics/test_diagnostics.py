"""What is read off a signal: frequencies, means and amplitudes over whole periods."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from fishrl.physics import (
    compute_coefficient,
    compute_pressure,
    compute_spectral_frequency,
    compute_strouhal,
    compute_vorticity,
    measure_cycles,
)

TIME = torch.arange(1000, dtype=torch.float64) * 0.1  # 9.37 periods and a bit
FREQUENCY = 0.0937
Measure = Callable[[Tensor, float], object]
LIFT = 0.3 + 0.8 * torch.sin(2.0 * math.pi * FREQUENCY * TIME + 0.4)


def test_cycles_do_not_depend_on_end_of_record() -> None:
    """Tolerances: linear and parabolic interpolation at 107 samples per period, (pi/107)^2 ~ 1e-3
    of a crossing's own distance, far less after cancelling between periods."""
    cycles = measure_cycles(LIFT, 0.1)
    assert cycles.num_cycles in (8, 9)
    assert cycles.frequency == pytest.approx(FREQUENCY, rel=1e-4)
    assert cycles.mean == pytest.approx(0.3, abs=1e-4)
    assert cycles.rms == pytest.approx(0.8 / math.sqrt(2.0), rel=1e-3)
    assert cycles.amplitude == pytest.approx(0.8, rel=1e-4)
    assert (cycles.low, cycles.high) == pytest.approx((-0.5, 1.1), abs=1e-4)
    drag = 1.3 + 0.01 * torch.cos(4.0 * math.pi * FREQUENCY * TIME)
    cycles = measure_cycles(drag, 0.1, clock=LIFT)  # over the periods of the lift
    assert cycles.frequency == pytest.approx(FREQUENCY, rel=1e-4)
    assert cycles.mean == pytest.approx(1.3, abs=1e-5)
    assert cycles.amplitude == pytest.approx(0.01, rel=1e-3)


def draw(samples: int, *, noise: float = 0.0, trend: float = 0.0, seed: int = 0) -> Tensor:
    """Return twenty periods of a sine of this many samples each, with noise and trend in total."""
    time = torch.arange(20 * samples, dtype=torch.float64) / samples
    generator = torch.Generator().manual_seed(seed)
    sine = torch.sin(2.0 * math.pi * time + 6.0 * seed)
    rough = torch.randn(len(time), generator=generator, dtype=torch.float64)
    return sine + noise * rough + trend * time / 20.0


@pytest.mark.parametrize("samples", [16, 40, 200])
@pytest.mark.parametrize("noise", [1e-9, 0.02, 0.1, 0.15, 0.25, 0.4, 3.0])
def test_frequency_of_a_noisy_signal_is_right_or_refused(samples: int, noise: float) -> None:
    """A crossing's error is noise / slope, 0.15 / 2 pi periods at most, over 19 periods."""
    for seed in range(5):
        signal = draw(samples, noise=noise, seed=seed)
        if noise > 0.15:
            with pytest.raises(ValueError, match="steady oscillation"):
                measure_cycles(signal, 1.0)
        else:
            found = measure_cycles(signal, 1.0).frequency * samples
            assert found == pytest.approx(1.0, rel=5e-3)


@pytest.mark.parametrize("trend", [0.1, 0.5, 2.0, 10.0])
def test_frequency_of_a_drifting_signal_is_right_or_refused(trend: float) -> None:
    signal = draw(200, trend=trend)
    if trend > 0.5:
        with pytest.raises(ValueError, match="steady oscillation"):
            compute_strouhal(signal, 1, length=200.0, speed=1.0)
    else:
        found = compute_strouhal(signal, 1, length=200.0, speed=1.0)
        assert found == pytest.approx(1.0, rel=5e-3)


def test_round_off_of_steady_force_has_no_frequency() -> None:
    rough = torch.randn(4000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for scale in (1e-17, 1e-8, 1.0):
        for signal in (0.3 + scale * rough, (0.3 + scale * rough).float()):
            with pytest.raises(ValueError, match=r"steady oscillation|whole periods"):
                measure_cycles(signal, 1.0)


def test_beating_signal_keeps_every_period() -> None:
    """Weak periods count, too: the band follows the noise, not the signal."""
    swell = 1.0 + 0.8 * torch.sin(torch.arange(4000, dtype=torch.float64) * 0.004)
    assert measure_cycles(swell * draw(200), 1.0).frequency * 200 == pytest.approx(1.0, rel=5e-3)


def test_vorticity_next_to_a_skin_is_of_the_water_alone() -> None:
    """A shear flow of 0.1 per node around a square of 3 x 4 nodes with other water in it."""
    y = torch.arange(12.0)[:, None].expand(12, 10)
    u = torch.stack((0.1 * y, 0.0 * y))[None]
    is_water = torch.ones(1, 12, 10, dtype=torch.bool)
    is_water[:, 4:7, 3:7] = False
    found = compute_vorticity(u.where(is_water[:, None], 5.0), is_water=is_water)
    assert torch.equal(found.isnan(), ~is_water)
    torch.testing.assert_close(found[is_water], torch.full_like(found[is_water], -0.1))


def test_cycles_need_two_whole_periods_about_their_mean() -> None:
    noise = torch.randn(20, generator=torch.Generator().manual_seed(5918), dtype=torch.float64)
    with pytest.raises(ValueError, match="measure longer"):  # two until the mean is refined
        measure_cycles(noise, 0.1)


@pytest.mark.parametrize(
    "measure",
    [
        measure_cycles,
        compute_spectral_frequency,
        lambda lift, interval: compute_strouhal(lift, interval, length=20.0, speed=0.1),
        lambda lift, interval: measure_cycles(LIFT, interval, clock=lift),
    ],
)
@pytest.mark.parametrize("first", [0, 990])
def test_measures_of_a_diverged_flow_are_refused(measure: Measure, first: int) -> None:
    lift = LIFT.clone()
    lift[first:] = torch.nan
    with pytest.raises(ValueError, match="diverged"):
        measure(lift, 0.1)


def test_spectrum_agrees_with_crossings_and_coefficients_with_definitions() -> None:
    """The bin is 0.01 wide; 2 % of it is what a parabola through a Hann window's line leaves."""
    assert compute_spectral_frequency(LIFT, 0.1) == pytest.approx(FREQUENCY, abs=2e-4)
    strouhal = compute_strouhal(LIFT, 0.1, length=20.0, speed=0.1)
    assert strouhal == pytest.approx(FREQUENCY * 200.0, rel=1e-4)
    force = torch.tensor([0.0, 0.5])
    assert compute_coefficient(force, length=20.0, speed=0.1, rho=1.25)[1] == pytest.approx(4.0)
    assert compute_pressure(torch.tensor(1.03)) == pytest.approx(0.01, rel=1e-4)
