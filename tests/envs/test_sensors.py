"""Bearing, distance and clearance, and the reward of an approach."""

import math

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import Predation
from fishrl.envs.sensors import compute_bearing_error, compute_clearance, sense_target
from fishrl.physics import FlowConfig


def doubles(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize(
    ("heading", "away", "expected"),
    [
        (0.0, (1.0, 1.0), math.pi / 4),
        (math.pi, (-1.0, -1.0), math.pi / 4),  # faces -x: left is -y
        (0.0, (-1.0, 0.0), math.pi),
        (7.5 * math.pi, (-1.0, 0.0), -math.pi / 2),  # several turns later
        (1.0, (0.0, 0.0), 0.0),
    ],
)
def test_bearing_error_is_positive_to_the_left(
    heading: float, away: tuple[float, float], expected: float
) -> None:
    error = compute_bearing_error(doubles(heading), doubles(*away)[None])
    assert float(error) == pytest.approx(expected, abs=1e-12)


def test_bearing_error_equals_atan2_within_half_a_turn() -> None:
    generator = torch.Generator().manual_seed(0)
    heading = 20.0 * torch.randn(2000, generator=generator, dtype=torch.float64)
    away = torch.randn(2000, 2, generator=generator, dtype=torch.float64)
    error = compute_bearing_error(heading, away)
    difference = torch.atan2(away[:, 1], away[:, 0]) - heading - error
    assert (difference / (2 * math.pi) - (difference / (2 * math.pi)).round()).abs().max() < 1e-14
    assert ((error > -math.pi) & (error <= math.pi)).all()


def test_sensed_target_does_not_depend_on_the_batch() -> None:
    generator = torch.Generator().manual_seed(1)
    head, target = 100 * torch.rand(2, 257, 2, generator=generator, dtype=torch.float64)
    heading = 7 * torch.rand(257, generator=generator, dtype=torch.float64)
    together = sense_target(head, heading, target, body_length=20)
    alone = torch.cat(
        [
            sense_target(h[None], a[None], t[None], body_length=20)
            for h, a, t in zip(head, heading, target, strict=True)
        ]
    )
    assert torch.equal(together, alone)


def test_target_is_sensed_in_body_lengths_from_the_head() -> None:
    sensed = sense_target(
        doubles(100.0, 50.0)[None], doubles(math.pi), doubles(40.0, 130.0)[None], body_length=20
    )
    expected = doubles(-3.0, 4.0, 5.0, -math.atan2(4.0, 3.0))
    torch.testing.assert_close(sensed[0], expected, atol=1e-12, rtol=0)


def test_clearance_is_the_distance_from_the_nearest_edge() -> None:
    outlines = doubles(
        *(5.0, 20.0, 8.0, 21.0), *(50.0, 20.0, 96.0, 21.0), *(50.0, 46.0, 60.0, 20.0),
        *(50.0, 2.0, 60.0, 20.0), *(-1.0, 20.0, 60.0, 20.0),
    ).view(5, 2, 2)  # fmt: skip
    clearance = compute_clearance(outlines, FlowConfig(width=100, height=50, tau=1.0))
    assert clearance.tolist() == [5.0, 3.0, 3.0, 2.0, -1.0]


def test_approach_reward_needs_a_smaller_distance_or_bearing_error() -> None:
    before, after = doubles(2.0, 2.0, 2.0, 2.0, 2.0), doubles(1.9, 2.1, 2.1, 2.0, 2.0)
    old_error, error = doubles(0.1, -0.5, 0.5, 0.2, 0.2), doubles(0.3, 0.4, -0.6, 0.2, -0.1)
    seen = (
        TensorDict({"target": torch.stack((*[distance] * 3, angle), -1)}, [5])
        for distance, angle in ((before, old_error), (after, error))
    )
    reward = Predation().reward(*seen)
    assert reward.tolist() == [1.0, 1.0, -1.0, -1.0, 1.0]
