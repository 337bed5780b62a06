"""Steering: to the line, against drift, within bounds, and by a learned network."""

from math import pi, radians
from pathlib import Path

import pytest
import torch
from torch import Tensor

from fishrl.envs.steering import PIDSteering, PolicySteering, Steering, load_weights, save_weights
from fishrl.modules import make_mlp


def observe_series(steering: Steering, y: list[float], heading: float = pi) -> Tensor:
    """Return what is remembered of a fish at some distances from the line, one after another."""
    place = [torch.tensor([[1.5, each]]).double() for each in y]
    heads = torch.tensor([heading], dtype=torch.float64)
    seen = [steering.observe(each, each, heads) for each in place]
    return torch.stack(seen[-steering.num_stacked :], 1)


def test_a_fish_above_the_line_turns_downwards_and_one_below_upwards() -> None:
    steering = PIDSteering(num_stacked=2, gain=0.5, integral_gain=0.0)
    turn = steering.turn(torch.cat([observe_series(steering, [y, y]) for y in (0.2, -0.2, 0.0)]))
    torch.testing.assert_close(turn, torch.tensor([0.1, -0.1, 0.0]).double())
    # heading pi + 0.1 points to (-cos 0.1, -sin 0.1): down


def test_the_sway_of_the_nose_is_not_steered_against() -> None:
    nose, middle = torch.tensor([[1.5, 0.1]]).double(), torch.tensor([[2.0, 0.0]]).double()
    seen = PIDSteering().observe(nose, middle, torch.tensor([pi], dtype=torch.float64))
    assert PIDSteering().turn(seen[:, None].expand(-1, 32, -1)).item() == pytest.approx(0.0)


def test_a_fish_that_heads_elsewhere_is_turned_back_upstream() -> None:
    steering = PIDSteering()
    turn = steering.turn(observe_series(steering, [0.0, 0.0], heading=pi - 0.15))
    assert turn.item() == pytest.approx(0.15)


def test_damping_turns_against_a_growing_offset() -> None:
    steering = PIDSteering(gain=0.0, integral_gain=0.0, damping=1.0)
    assert steering.turn(observe_series(steering, [0.0, 0.1])).item() == pytest.approx(0.1)


def test_a_fish_that_long_was_beside_the_line_aims_across_it() -> None:
    steering = PIDSteering(num_stacked=4, gain=0.0, integral_gain=0.5)
    turn = steering.turn(
        observe_series(steering, [0.9, 0.3, 0.2, 0.1, 0.0])
    )  # of which four are kept
    assert turn.item() == pytest.approx(0.5 * 0.15)


def test_the_turn_of_an_interval_and_the_angle_off_upstream_are_bounded() -> None:
    steering = PIDSteering(gain=5.0, max_angle_degrees=20.0, max_turn_degrees=8.0)
    assert steering.turn(observe_series(steering, [1.0, 1.0])).item() == pytest.approx(radians(8.0))
    there = observe_series(steering, [1.0, 1.0], heading=pi + radians(19.0))
    assert steering.turn(there).item() == pytest.approx(radians(1.0))


def test_a_heading_and_the_same_a_turn_further_are_steered_alike() -> None:
    steering = PIDSteering()
    seen = torch.tensor([[0.0, heading] for heading in (pi, -pi, 3.0 * pi, pi - 0.1)]).double()
    turns = steering.turn(seen[:, None].expand(-1, steering.num_stacked, -1))
    expected = torch.tensor([0.0, 0.0, 0.0, 0.1]).double()
    torch.testing.assert_close(turns, expected, rtol=0, atol=1e-6)


def linear_layers(network: torch.nn.Sequential) -> list[tuple[Tensor, Tensor]]:
    return [(m.weight, m.bias) for m in network if isinstance(m, torch.nn.Linear)]


def test_the_networks_likeliest_action_turns_the_fish(tmp_path: Path) -> None:
    network = make_mlp((16, 256, 256, 3), generator=torch.Generator().manual_seed(3))
    save_weights(linear_layers(network), tmp_path / "steer.pt")
    seen = torch.randn(40, 12, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    expected = network(seen[:, [2, 5, 8, 11]].flatten(1).float()).argmax(-1)
    assert len(expected.unique()) > 1
    steering = PolicySteering(path=str(tmp_path / "steer.pt"), decisions_per_T=3)
    assert steering.num_stacked == 12
    torch.testing.assert_close(steering.turn(seen), radians(5.0) * (expected.double() - 1.0))


def test_the_network_sees_a_point_upstream_as_it_saw_food(tmp_path: Path) -> None:
    """x and y of the point from the nose, its distance, and how far to the left it lies."""
    save_weights(linear_layers(make_mlp((16, 8, 3))), tmp_path / "w")
    steering = PolicySteering(path=str(tmp_path / "w"), ahead_bl=2.0)
    nose, middle = torch.tensor([[1.5, 0.5]]).double(), torch.tensor([[2.0, 0.0]]).double()
    (seen,) = steering.observe(nose, middle, torch.tensor([pi]).double())
    expected = torch.tensor([-2.0, -0.5, 4.25**0.5, torch.atan(torch.tensor(0.25))]).double()
    torch.testing.assert_close(seen, expected, rtol=0, atol=1e-6)


def test_weights_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.pt"
    save_weights(linear_layers(make_mlp((8, 4, 3))), path)
    with pytest.raises(ValueError, match=r"layers of widths \[8, 4, 3\], expected 16"):
        PolicySteering(path=str(path))
    save_weights([(torch.zeros(4, 16), torch.zeros(4)), (torch.zeros(3, 5), torch.zeros(3))], path)
    with pytest.raises(ValueError, match="no consecutive layers"):
        load_weights(path)
    torch.save({"a": 1}, path)
    with pytest.raises(ValueError, match="no consecutive layers"):
        load_weights(path)
    path.write_bytes(b"no weights")
    with pytest.raises(ValueError, match="cannot be read"):
        load_weights(path)
