"""Hand-crafted controllers: bearing, interception, seeds and masks."""

import math
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict

from fishrl.modules import InterceptPolicy, PursuitPolicy, RandomPolicy
from fishrl.modules.controllers import LEAD_T

CLOCKWISE, KEEP, COUNTER_CLOCKWISE = 0, 1, 2
TURN = math.radians(15.0)


def seen(
    *,
    food: tuple[float, float],
    heading: float,
    food_velocity: float = 0.0,
    speed: float = 0.4,
    room: float = math.inf,
) -> TensorDict:
    """Return the observation of a fish that has swum straight; ``food`` is relative to its head.

    The food reverses after ``room`` body lengths.
    """
    ahead = food_velocity * LEAD_T * torch.arange(160)
    ahead = torch.minimum(ahead, 2 * room - ahead)
    frames = []
    for age in (3, 2, 1, 0):
        x = food[0] + age * speed * math.cos(heading)
        y = food[1] + age * (speed * math.sin(heading) - food_velocity)
        error = math.remainder(math.atan2(y, x) - heading, 2 * math.pi)
        frames += [x, y, math.hypot(x, y), error]
    return TensorDict(
        {
            "observation_stack": torch.tensor([frames]),
            "action_mask": torch.ones(1, 3, dtype=torch.bool),
            "food_ahead": torch.stack((torch.zeros_like(ahead), ahead), -1)[None],
        },
        [1],
    )


def test_random_actions_are_legal_uniform_and_seeded() -> None:
    mask = torch.tensor([[True, False, True]]).expand(9000, 3)
    td = TensorDict({"action_mask": mask, "observation": torch.zeros(9000, 4)}, [9000])
    state = torch.get_rng_state()
    first, second, other = (RandomPolicy(seed=s)(td.clone())["action"] for s in (0, 0, 1))
    numbers, same = (RandomPolicy(seed=0, num_numbers=2)(td.clone())["action"] for _ in range(2))
    assert torch.equal(torch.get_rng_state(), state)
    counts = torch.bincount(first, minlength=3)
    assert counts[1] == 0
    # Binomial with n = 9000, p = 1/2: 4.5 standard deviations are 213.
    assert abs(int(counts[0]) - 4500) < 213
    assert torch.equal(first, second) and torch.equal(numbers, same)
    assert not torch.equal(first, other)
    # Mean of uniform numbers: 4.5 standard deviations of 1 / sqrt(3 * 9000) are 0.027.
    assert numbers.shape == (9000, 2)
    assert numbers.abs().max() <= 1.0 and (numbers.mean(0).abs() < 0.027).all()


@pytest.mark.parametrize("kind", [PursuitPolicy, InterceptPolicy])
@pytest.mark.parametrize("heading", [math.pi, -2.5])
@pytest.mark.parametrize("error", [0.4 * TURN, 0.6 * TURN, -0.6 * TURN, -3.0])
def test_controllers_turn_towards_still_food_at_any_heading(
    error: float, heading: float, kind: Callable[..., PursuitPolicy | InterceptPolicy]
) -> None:
    """Continuous pursuit turns by the heading error at full speed; interception leads slightly."""
    place = 5 * math.cos(heading + error), 5 * math.sin(heading + error)
    td = seen(food=place, heading=heading)
    action = KEEP if abs(error) < 0.5 * TURN else (COUNTER_CLOCKWISE, CLOCKWISE)[error < 0]
    assert kind()(td.clone())["action"].tolist() == [action]
    illegal = td.clone()
    illegal["action_mask"][0, action] = False
    assert kind()(illegal)["action"].tolist() != [action]
    turn = kind(num_numbers=2)(td.exclude("action_mask"))["action"]
    share = max(-1.0, min(1.0, error / TURN))
    assert turn.abs().max() <= 1.0 and turn[0, 0] * error > 0
    if kind is PursuitPolicy:
        torch.testing.assert_close(turn, torch.tensor([[share, 1.0]]), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("food_velocity", "room", "action"),
    [
        (0.3, math.inf, CLOCKWISE),
        (-0.3, math.inf, COUNTER_CLOCKWISE),
        (0.3, 0.1, COUNTER_CLOCKWISE),  # it reverses before the fish arrives
    ],
)
def test_intercept_leads_moving_food(food_velocity: float, room: float, action: int) -> None:
    # food dead ahead of a fish that faces -x; +y is to its right
    td = seen(food=(-4.0, 0.0), heading=math.pi, food_velocity=food_velocity, room=room)
    assert PursuitPolicy()(td.clone())["action"].tolist() == [KEEP]
    assert InterceptPolicy()(td)["action"].tolist() == [action]


def test_intercept_does_not_circle_close_food() -> None:
    """Turning towards food abeam within the turning diameter would circle it forever."""
    td = seen(food=(0.0, 1.5), heading=0.0)
    assert PursuitPolicy()(td.clone())["action"].tolist() == [COUNTER_CLOCKWISE]
    assert InterceptPolicy()(td)["action"].tolist() != [COUNTER_CLOCKWISE]


def test_yaw_damping_prevents_overshoot() -> None:
    own = torch.zeros(1, 5)
    for yaw_rate, action in ((0.0, COUNTER_CLOCKWISE), (2.0, KEEP), (6.0, CLOCKWISE)):
        own[0, -1] = yaw_rate  # radians per T
        td = seen(food=(3.0, 1.0), heading=0.0)  # 0.32 radians to the left
        td["observation_stack"] = torch.cat((own, td["observation_stack"][:, -4:]), -1)
        policy = PursuitPolicy(turn=0.5, yaw_damping_T=0.1)
        assert policy(td)["action"].tolist() == [action]
