"""The example of gradients through the water, on a short motion."""

import torch

from examples.gradient_inverse import GUESS, Recording, fit


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
