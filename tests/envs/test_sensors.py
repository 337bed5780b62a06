"""Bearing, distance and clearance, and the reward of an approach."""

import math

import torch
from tensordict import TensorDict

from fishrl.envs import Predation
from fishrl.envs.sensors import compute_bearing_error, compute_clearance, sense_target
from fishrl.physics import FlowConfig


def doubles(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_bearing_error_equals_atan2_within_half_a_turn() -> None:
    """It is positive to the left, and 0 at the target itself."""
    generator = torch.Generator().manual_seed(0)
    heading = 20.0 * torch.randn(2000, generator=generator, dtype=torch.float64)
    away = torch.randn(2000, 2, generator=generator, dtype=torch.float64)
    heading[0], away[0] = 0.0, doubles(-1.0, 0.0)  # straight behind
    error = compute_bearing_error(heading, away)
    turns = (torch.atan2(away[:, 1], away[:, 0]) - heading - error) / (2 * math.pi)
    assert (turns - turns.round()).abs().max() < 1e-14
    assert ((error > -math.pi) & (error <= math.pi)).all()
    assert compute_bearing_error(doubles(1.0), doubles(0.0, 0.0)[None]) == 0.0
    both = [sense_target(away[i], heading[i], away[i] + 9, body_length=20) for i in ([3], [3, 4])]
    assert torch.equal(both[0][0], both[1][0])  # a row does not depend on the batch


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
    approach = Predation().reward(*seen)["approach"]
    assert approach.tolist() == [1.0, 1.0, -1.0, -1.0, 1.0]
