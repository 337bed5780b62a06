"""The hand-crafted controllers: bearing, interception, seeds and masks."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict

from fishrl.modules import InterceptPolicy, PursuitPolicy, RandomPolicy

CLOCKWISE, KEEP, COUNTER_CLOCKWISE = 0, 1, 2
TURN = math.radians(15.0)


def seen(
    *,
    food: tuple[float, float],
    heading: float,
    food_velocity: float = 0.0,
    speed: float = 0.4,
    mask: tuple[bool, bool, bool] = (True, True, True),
    time: float = 20.0,
) -> TensorDict:
    """What a fish that has swum straight sees of food that lies at ``food`` from its head."""
    frames = []
    for age in (3, 2, 1, 0):
        x = food[0] + age * speed * math.cos(heading)
        y = food[1] + age * (speed * math.sin(heading) - food_velocity)
        error = math.remainder(math.atan2(y, x) - heading, 2 * math.pi)
        frames += [x, y, math.hypot(x, y), error]
    return TensorDict(
        {
            "observation_stack": torch.tensor([frames]),
            "action_mask": torch.tensor([mask]),
            "step_count": torch.tensor([[time]]),
        },
        [1],
    )


def test_random_actions_are_uniform_over_legal_ones_and_repeat_with_the_seed() -> None:
    mask = torch.tensor([[True, False, True]]).expand(9000, 3)
    td = TensorDict({"action_mask": mask}, [9000])
    torch.manual_seed(0)
    expected = torch.rand(3)
    torch.manual_seed(0)
    first, second, other = (RandomPolicy(seed=s)(td.clone())["action"] for s in (0, 0, 1))
    assert torch.equal(torch.rand(3), expected)  # the global generator is left alone
    counts = torch.bincount(first, minlength=3)
    assert counts[1] == 0
    # Binomial with n = 9000, p = 1/2: 4.5 standard deviations are 213.
    assert abs(int(counts[0]) - 4500) < 213
    assert torch.equal(first, second)
    assert not torch.equal(first, other)


@pytest.mark.parametrize(
    ("error", "action"),
    [
        (0.6 * TURN, COUNTER_CLOCKWISE),
        (0.4 * TURN, KEEP),
        (-0.4 * TURN, KEEP),
        (-0.6 * TURN, CLOCKWISE),
        (3.0, COUNTER_CLOCKWISE),
        (-3.0, CLOCKWISE),
    ],
)
def test_pursuit_turns_towards_food_more_than_half_a_turn_off(error: float, action: int) -> None:
    td = seen(food=(5 * math.cos(error), 5 * math.sin(error)), heading=0.0)
    assert PursuitPolicy()(td)["action"].tolist() == [action]


@pytest.mark.parametrize(("error", "share"), [(0.5 * TURN, 0.5), (-0.2 * TURN, -0.2), (3.0, 1.0)])
@pytest.mark.parametrize("kind", [PursuitPolicy, InterceptPolicy])
def test_continuous_pursuit_turns_by_the_error_at_full_speed(
    kind: type, error: float, share: float
) -> None:
    td = seen(food=(5 * math.cos(error), 5 * math.sin(error)), heading=0.0)
    action = kind(is_continuous=True)(td.exclude("action_mask"))["action"]
    if kind is PursuitPolicy:
        torch.testing.assert_close(action, torch.tensor([[share, 1.0]]))
    else:  # it aims off food within reach of a turn only
        assert action.abs().max() <= 1.0 and action[0, 0].sign() == torch.tensor(error).sign()


def test_random_numbers_are_uniform_and_repeat_with_the_seed() -> None:
    td = TensorDict({"observation": torch.zeros(9000, 4)}, [9000])
    first, second = (RandomPolicy(seed=0, num_numbers=2)(td.clone())["action"] for _ in range(2))
    assert torch.equal(first, second) and first.shape == (9000, 2)
    # Mean of uniform numbers: 4.5 standard deviations of 1 / sqrt(3 * 9000) are 0.027.
    assert first.abs().max() <= 1.0 and (first.mean(0).abs() < 0.027).all()


@pytest.mark.parametrize("policy", [PursuitPolicy(), InterceptPolicy()])
def test_masked_action_is_not_taken(policy: PursuitPolicy | InterceptPolicy) -> None:
    td = seen(food=(0.0, 6.0), heading=0.0, mask=(True, True, False))
    assert policy(td)["action"].tolist() != [COUNTER_CLOCKWISE]


@pytest.mark.parametrize("heading", [math.pi, 0.0, 2.0, -2.5])
def test_actions_do_not_change_when_the_scene_is_rotated(heading: float) -> None:
    """Heading is read off bearing error and direction; still food makes the scene isotropic."""
    for angle, action in ((0.05, KEEP), (0.6, COUNTER_CLOCKWISE), (-0.6, CLOCKWISE)):
        food = (4 * math.cos(heading + angle), 4 * math.sin(heading + angle))
        for policy in (PursuitPolicy(), InterceptPolicy()):
            assert policy(seen(food=food, heading=heading))["action"].tolist() == [action]


def test_intercept_leads_moving_food_unlike_pursuit() -> None:
    for velocity, action in ((0.3, CLOCKWISE), (-0.3, COUNTER_CLOCKWISE)):
        # Food dead ahead of a fish that faces -x; upwards is to its right.
        td = seen(food=(-3.0, 0.0), heading=math.pi, food_velocity=velocity)
        assert PursuitPolicy()(td.clone())["action"].tolist() == [KEEP]
        assert InterceptPolicy()(td)["action"].tolist() == [action]


def test_intercept_subtracts_its_own_sideways_motion() -> None:
    """Still food seen from a fish that swims obliquely seems to move; it is not led."""
    for heading in (math.pi - 0.6, math.pi + 0.6):
        food = (3 * math.cos(heading), 3 * math.sin(heading))
        assert InterceptPolicy()(seen(food=food, heading=heading))["action"].tolist() == [KEEP]


def test_intercept_predicts_reversals_on_a_known_route() -> None:
    # Food at y = 3.4 on its way up to 3.5, the fish 4 L away at the same height: when it arrives,
    # the food is on its way down again.
    informed = InterceptPolicy(food_limits_bl=(1.5, 3.5), food_start_bl=2.5, food_still_T=5.0)
    time = 5.0 + 0.9 / 0.3
    td = seen(food=(-4.0, 0.0), heading=math.pi, food_velocity=0.3, time=time)
    assert InterceptPolicy()(td.clone())["action"].tolist() == [CLOCKWISE]  # leads it upwards
    assert informed(td)["action"].tolist() == [COUNTER_CLOCKWISE]


def test_intercept_estimates_an_unknown_first_direction() -> None:
    for way in (1, -1):
        informed, estimating = (
            InterceptPolicy(food_limits_bl=(1.5, 3.5), food_start_bl=2.5, food_direction=direction)
            for direction in (way, 0)
        )
        # After 1 T on its way, and after it has turned back once.
        for time, velocity in ((6.0, 0.3 * way), (5.0 + 1.6 / 0.3, -0.3 * way)):
            td = seen(food=(-2.5, 0.0), heading=math.pi, food_velocity=velocity, time=time)
            assert torch.equal(informed(td.clone())["action"], estimating(td.clone())["action"])


def test_intercept_does_not_circle_food_inside_its_turning_circle() -> None:
    """Food abeam at less than the turning diameter: turning towards it would circle it for ever."""
    td = seen(food=(0.0, 1.5), heading=0.0)
    assert PursuitPolicy()(td.clone())["action"].tolist() == [COUNTER_CLOCKWISE]
    assert InterceptPolicy()(td)["action"].tolist() != [COUNTER_CLOCKWISE]
