"""Heading controllers: PID towards the centreline, and a learned network."""

from math import pi, radians
from pathlib import Path
from shutil import copyfile

import pytest
import torch
from torch import Tensor

from fishrl.envs.steering import PIDSteering, PolicySteering, Steering, load_weights
from fishrl.modules import make_mlp
from fishrl.physics.cache_key import make_key
from fishrl.settings import build, describe


def observe_series(steering: Steering, y: list[float], heading: float = pi) -> Tensor:
    """Return the stacked observations of a fish at successive offsets from the centreline."""
    place = [torch.tensor([[1.5, each]]).double() for each in y]
    heads = torch.tensor([heading], dtype=torch.float64)
    seen = [steering.observe(each, each, heads) for each in place]
    return torch.stack(seen[-steering.num_stacked :], 1)


@pytest.mark.parametrize(
    ("gains", "offsets", "heading", "expected"),
    [
        ((0.5, 0.0, 0.0), [0.2, 0.2], pi, 0.1),  # above the line: pi + 0.1 points down
        ((0.5, 0.0, 0.0), [-0.2, -0.2], pi, -0.1),
        ((0.5, 0.0, 0.0), [0.0, 0.0], pi - 0.15, 0.15),  # back upstream
        ((0.0, 0.0, 1.0), [0.0, 0.1], pi, 0.1),  # against a growing offset
        ((0.0, 0.5, 0.0), [0.9, 0.3, 0.2, 0.1, 0.0], pi, 0.5 * 0.15),  # four are remembered
        ((5.0, 0.0, 0.0), [1.0, 1.0], pi, radians(8.0)),  # the turn is bounded
        ((5.0, 0.0, 0.0), [1.0, 1.0], pi + radians(19.0), radians(1.0)),  # so is the target angle
    ],
)
def test_pid_turns_towards_the_centreline_within_its_bounds(
    gains: tuple[float, ...], offsets: list[float], heading: float, expected: float
) -> None:
    gain, integral_gain, damping = gains
    steering = PIDSteering(
        num_stacked=min(4, len(offsets)), gain=gain, integral_gain=integral_gain, damping=damping,
        max_angle_degrees=20.0, max_turn_degrees=9.0 if expected == 0.15 else 8.0,
    )  # fmt: skip
    turn = steering.turn(observe_series(steering, offsets, heading))
    assert turn.item() == pytest.approx(expected)


def test_sway_and_whole_turns_do_not_steer() -> None:
    steering, headings = PIDSteering(), torch.tensor([pi, -pi, 3.0 * pi, pi - 0.1]).double()
    nose, middle = (torch.tensor([each]).double().expand(4, 2) for each in ((1.5, 0.1), (2.0, 0.0)))
    seen = steering.observe(nose, middle, headings)
    turns = steering.turn(seen[:, None].expand(-1, steering.num_stacked, -1))
    expected = torch.tensor([0.0, 0.0, 0.0, 0.1]).double()
    torch.testing.assert_close(turns, expected, rtol=0, atol=1e-6)


def linear_layers(network: torch.nn.Sequential) -> list[tuple[Tensor, Tensor]]:
    return [(m.weight.detach(), m.bias.detach()) for m in network if isinstance(m, torch.nn.Linear)]


def test_network_turns_the_fish_by_its_most_probable_action(tmp_path: Path) -> None:
    network = make_mlp((16, 256, 256, 3), generator=torch.Generator().manual_seed(3))
    torch.save(linear_layers(network), tmp_path / "steer.pt")
    seen = torch.randn(40, 12, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    expected = network(seen[:, [2, 5, 8, 11]].flatten(1).float()).argmax(-1)
    assert len(expected.unique()) > 1
    steering = PolicySteering(path=str(tmp_path / "steer.pt"), decisions_per_T=3)
    assert steering.num_stacked == 12
    torch.testing.assert_close(steering.turn(seen), radians(5.0) * (expected.double() - 1.0))


def test_keys_depend_on_weights_not_on_path(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in "ab"]
    keys = []
    for seed in range(2):
        network = make_mlp((16, 8, 3), generator=torch.Generator().manual_seed(seed))
        torch.save(linear_layers(network), paths[0])
        copyfile(*paths)
        keys.append({make_key(PolicySteering(path=str(path))) for path in paths})
        if seed == 0:
            stored = describe(PolicySteering(path=str(paths[0])))
            assert build(PolicySteering, stored).path == str(paths[0])
    assert len(keys[0]) == len(keys[1]) == 1 and keys[0] != keys[1]
    with pytest.raises(ValueError, match=r"weights = .* has others"):
        build(PolicySteering, stored)


def test_packaged_weights_are_found_on_any_machine() -> None:
    stored = describe(PolicySteering())
    assert stored["path"] == ""
    del stored["weights"]  # as earlier versions stored it
    stored["path"] = "/elsewhere/fishrl/envs/steering.pt"
    assert build(PolicySteering, stored) == PolicySteering()


def test_invalid_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.pt"
    torch.save(linear_layers(make_mlp((8, 4, 3))), path)
    with pytest.raises(ValueError, match="no layers from 16 inputs to 3 actions"):
        PolicySteering(path=str(path))
    loose = [(torch.zeros(4, 16), torch.zeros(4)), (torch.zeros(3, 5), torch.zeros(3))]
    for content in (loose, {"a": 1}):
        torch.save(content, path)
        with pytest.raises(ValueError, match="no layers"):
            load_weights(path)
    path.write_bytes(b"no weights")
    with pytest.raises(ValueError, match="cannot be read"):
        load_weights(path)
