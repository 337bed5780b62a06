"""The lateral-line classifier: input, checks and file."""

from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.modules import LateralLineClassifier
from tests.sines import FLOWS, SENSORS, make_samples


def make(**changes: Any) -> LateralLineClassifier:
    arguments = {"flows": FLOWS, "sensors": SENSORS, "hidden": (8,)} | changes
    return LateralLineClassifier(**arguments, generator=torch.Generator().manual_seed(0))


def noise(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, 5, 6, generator=torch.Generator().manual_seed(1))


def test_default_input_excludes_time_place_and_older_samples() -> None:
    signal = noise(4, 16)
    other, older = signal.clone(), signal.clone()
    other[..., :3] += 1.0
    classifier, cheat = make(), make(features=SENSORS["features"])
    assert classifier.features == ["u", "v", "p"]
    assert torch.equal(classifier(signal), classifier(other))
    assert not torch.allclose(cheat(signal), cheat(other))
    classifier = make(num_samples=4)
    older[:, :12] = 0.0
    assert torch.equal(classifier(signal), classifier(older))
    older[:, 12] = 0.0
    assert not torch.allclose(classifier(signal), classifier(older))


def test_normalisation_scales_all_but_constant_features() -> None:
    classifier, signal = make(), make_samples(30)["lateral_line"]
    classifier.set_normalisation(signal)
    scaled = (classifier.read(signal) - classifier.mean) / classifier.scale
    assert torch.allclose(scaled.mean((0, 1)), torch.zeros(5, 3), atol=1e-4)
    deviation = scaled.std((0, 1), unbiased=False)
    assert torch.allclose(deviation, torch.tensor([1.0, 1.0, 0.0]).expand(5, 3), atol=1e-4)
    signal[..., 3] = 1e-8 * noise(300, 16)[..., 0]
    classifier.set_normalisation(signal)
    assert (classifier.scale[:, 0] == 1.0).all()


@pytest.mark.parametrize(("num_samples", "intervals"), [(1, 1), (16, 1), (17, 2)])
def test_saved_classifier_is_the_same(num_samples: int, intervals: int, tmp_path: Path) -> None:
    classifier = make(num_samples=num_samples, features=["p", "u"])
    classifier.set_normalisation(noise(8, num_samples))
    classifier.save(tmp_path / "classifier.pt")
    other = LateralLineClassifier.load(tmp_path / "classifier.pt")
    signal = noise(3, num_samples)
    assert torch.equal(classifier(signal), other(signal))
    assert not other.training
    assert (other.flows, other.sensors) == (classifier.flows, classifier.sensors)
    assert (other.features, other.num_intervals) == (["p", "u"], intervals)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"flows": FLOWS[:1]}, "two or more, with unique names; got"),
        ({"flows": [FLOWS[0], FLOWS[0]]}, "two or more, with unique names; got"),
        ({"sensors": {"features": ["u"]}}, r"lacks \['num_neuromasts', 'num_samples'\]"),
    ],
)
def test_invalid_settings_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**changes)


def test_signal_of_other_sensors_is_refused() -> None:
    for shape in ((2, 8, 5, 6), (2, 16, 4, 6), (2, 16, 5, 7), (5, 6)):
        with pytest.raises(ValueError, match="at least 16 samples, 5 neuromasts, 6 features"):
            make()(torch.zeros(shape))


def test_other_flows_and_sensors_are_refused() -> None:
    almost = [{**flow, "stream_speed_bl": flow["stream_speed_bl"] * (1 + 1e-9)} for flow in FLOWS]
    make().check(flows=almost, sensors={**SENSORS, "features": tuple(SENSORS["features"])})
    for flows, sensors, message in (
        (FLOWS[:2], SENSORS, r"flows: .* \['I', 'II', 'III'\], here it is \['I', 'II'\]"),
        (FLOWS, SENSORS | {"num_neuromasts": 7}, "num_neuromasts = 5, here it is 7"),
    ):
        with pytest.raises(ValueError, match=message):
            make().check(flows=flows, sensors=sensors)
