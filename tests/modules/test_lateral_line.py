"""The lateral-line machine: what it reads, what it refuses, and that a file brings it back."""

from __future__ import annotations

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


def test_it_gives_one_logit_per_flow_and_any_batch() -> None:
    machine = make()
    assert machine(noise(16)).shape == (3,)
    assert machine(noise(2, 7, 16)).shape == (2, 7, 3)


def test_one_seed_gives_one_machine() -> None:
    signal = noise(4, 16)
    assert torch.equal(make()(signal), make()(signal))


def test_clock_and_place_are_left_out_unless_asked_for() -> None:
    signal = noise(4, 16)
    other = signal.clone()
    other[..., :3] += 1.0
    machine, cheat = make(), make(features=SENSORS["features"])
    assert machine.features == ["u", "v", "p"]
    assert torch.equal(machine(signal), machine(other))
    assert not torch.allclose(cheat(signal), cheat(other))


def test_only_the_newest_samples_are_read() -> None:
    machine, signal = make(num_samples=4), noise(3, 16)
    changed = signal.clone()
    changed[:, :12] = 0.0
    assert torch.equal(machine(signal), machine(changed))
    changed[:, 12] = 0.0
    assert not torch.allclose(machine(signal), machine(changed))


@pytest.mark.parametrize(("num_samples", "intervals"), [(1, 1), (16, 1), (17, 2), (48, 3)])
def test_longer_windows_take_more_control_intervals(num_samples: int, intervals: int) -> None:
    assert make(num_samples=num_samples).num_intervals == intervals


def test_normalised_features_have_mean_zero_and_deviation_one_unless_they_never_change() -> None:
    machine, signal = make(), make_samples(30)["lateral_line"]
    machine.set_normalisation(signal)
    scaled = (machine.read(signal) - machine.mean) / machine.scale
    assert torch.allclose(scaled.mean((0, 1)), torch.zeros(5, 3), atol=1e-4)
    deviation = scaled.std((0, 1), unbiased=False)
    assert torch.allclose(deviation, torch.tensor([1.0, 1.0, 0.0]).expand(5, 3), atol=1e-4)


def test_a_feature_that_is_zero_but_for_rounding_is_not_blown_up() -> None:
    machine, signal = make(), make_samples(30)["lateral_line"]
    noise = torch.randn(signal.shape[:-1], generator=torch.Generator().manual_seed(0))
    signal[..., machine.sensors["features"].index(machine.features[0])] = 1e-8 * noise
    machine.set_normalisation(signal)
    assert (machine.scale[:, 0] == 1.0).all()


def test_a_saved_machine_says_the_same_and_knows_what_it_was_made_for(tmp_path: Path) -> None:
    machine = make(num_samples=20, features=["p", "u"])
    machine.set_normalisation(noise(8, 20))
    machine.save(tmp_path / "machine.pt")
    other = LateralLineClassifier.load(tmp_path / "machine.pt")
    assert torch.equal(machine(noise(3, 20)), other(noise(3, 20)))
    assert not other.training
    assert (other.flows, other.sensors) == (machine.flows, machine.sensors)
    assert (other.features, other.num_intervals) == (["p", "u"], 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"flows": FLOWS[:1]}, "two or more flows"),
        ({"flows": [FLOWS[0], FLOWS[0]]}, "different names"),
        ({"flows": [FLOWS[0], {"stream_speed_bl": 2.0}]}, "different names"),
        ({"sensors": {"features": ["u"]}}, r"lacks \['num_neuromasts', 'num_samples'\]"),
        ({"features": ["w"]}, r"features = \['w'\]: give one or more of"),
        ({"features": []}, "give one or more of"),
        ({"num_samples": 0}, "must be at least 1"),
    ],
)
def test_a_machine_that_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**changes)


@pytest.mark.parametrize("shape", [(8, 5, 6), (16, 4, 6), (16, 5, 7), (5, 6)])
def test_a_signal_of_other_sensors_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="at least 16 samples, 5 neuromasts, 6 features"):
        make()(torch.zeros(2, *shape) if len(shape) == 3 else torch.zeros(shape))


def test_the_flows_and_sensors_it_was_trained_for_pass() -> None:
    almost = [{**flow, "stream_speed_bl": flow["stream_speed_bl"] * (1 + 1e-9)} for flow in FLOWS]
    make().check(flows=almost, sensors={**SENSORS, "features": tuple(SENSORS["features"])})


@pytest.mark.parametrize(
    ("flows", "sensors", "message"),
    [
        (FLOWS[:2], SENSORS, r"knows 3 flows \(I, II, III\), here are 2 \(I, II\)"),
        (
            [*FLOWS[:2], {**FLOWS[2], "stream_speed_bl": 2.0}],
            SENSORS,
            "flow 2: .* stream_speed_bl = 1.5, here it is 2.0",
        ),
        (FLOWS[::-1], SENSORS, "flow 0: .* name = 'I', here it is 'III'"),
        (FLOWS, {**SENSORS, "num_neuromasts": 7}, "num_neuromasts = 5, here it is 7"),
        (FLOWS, {**SENSORS, "features": ["u"]}, "trained for features"),
        (FLOWS, {**SENSORS, "distance": 2.0}, "distance = None, here it is 2.0"),
    ],
)
def test_other_flows_and_sensors_are_refused(
    flows: list[dict[str, Any]], sensors: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        make().check(flows=flows, sensors=sensors)


def test_a_file_that_is_not_there_or_no_machine_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no such file; train one"):
        LateralLineClassifier.load(tmp_path / "none.pt")
    (tmp_path / "words.pt").write_text("not a file of torch")
    with pytest.raises(ValueError, match="cannot be read"):
        LateralLineClassifier.load(tmp_path / "words.pt")
    torch.save({"weights": torch.zeros(3)}, tmp_path / "other.pt")
    with pytest.raises(ValueError, match="not one"):
        LateralLineClassifier.load(tmp_path / "other.pt")
