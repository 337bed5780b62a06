"""Predation: its food, starts, rewards and ends, and the bad input it refuses."""

import math
from random import Random
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import FlowEnv, Predation
from fishrl.envs.control import ContinuousFrequency, Turn
from fishrl.envs.tasks.food import LEAD_T
from fishrl.modules import controllers
from tests.envs.conftest import CONTINUOUS, SMALL, act, make_flows, starts_at

pytestmark = pytest.mark.usefixtures("kinematic")
KEEP = 1


def begin(task: Predation, starts: TensorDict) -> FlowEnv:
    """Return an environment in which each row has begun at one of the starts."""
    env = make_flows(task, starts.shape[0], starts=starts)
    env.reset()
    return env


def test_food_rests_and_then_moves_between_its_limits() -> None:
    task, age_T = Predation(**SMALL), torch.tensor([0.0, 5.0, 7.0, 12.0]).double()
    starts = starts_at((6.0, 2.5)).expand(4)
    places = task.locate_food(starts, age_T * task.scales.period) / task.body_length
    # up by 0.3 L / T after 5 T; it turns at 3.5 L after another 3.33 T
    expected = torch.tensor([[2.5, 2.5], [2.5, 2.5], [2.5, 3.1], [2.5, 2.4]]).double()
    torch.testing.assert_close(places, expected)


@pytest.mark.parametrize("body_length", [50, 100])
def test_starts_are_whole_nodes_in_the_papers_box(body_length: int) -> None:
    """At L = 100: x in [500, 750], y in [25, 475], the paper's Task 1."""
    task = Predation(body_length=body_length, levels=1, reynolds=500.0)
    starts = task.sample_starts(2000, torch.Generator().manual_seed(0))
    head, length = starts["head"], body_length
    assert torch.equal(head, head.round())
    low, high = head.amin(0) / length, head.amax(0) / length
    assert low.tolist() == pytest.approx([5.0, 0.25], abs=0.1)
    assert high.tolist() == pytest.approx([7.5, 4.75], abs=0.1)
    assert (low >= torch.tensor([5.0, 0.25])).all() and (high <= torch.tensor([7.5, 4.75])).all()
    assert (starts["heading"] == math.pi).all()
    assert (starts["food_direction"] == 1.0).all()
    task.check_starts(starts)


def test_starts_keep_fish_clear_of_walls() -> None:
    task = Predation(**SMALL, start_x_bl=(8.0, 10.0), start_y_bl=(0.0, 5.0))
    (x_low, x_high), (y_low, y_high) = task.start_range
    assert (x_low, x_high) == (160, 176)  # the tail, 20 nodes behind, keeps 3 nodes from node 199
    assert y_low == 99 - y_high == 6  # 3 nodes, and 0.126 L of beating tail
    corners = starts_at(*((x / 20, y / 20) for x in (x_low, x_high) for y in (y_low, y_high)))
    task.check_starts(corners)


@pytest.mark.parametrize(("direction", "ways"), [("random", {-1.0, 1.0}), ("down", {-1.0})])
def test_food_goes_the_given_way(direction: str, ways: set[float]) -> None:
    starts = Predation(**SMALL, food_direction=direction).sample_starts(64, torch.Generator())
    assert set(starts["food_direction"].tolist()) == ways


@pytest.mark.parametrize("seed", range(5))
def test_each_episode_draws_its_own_path(seed: int) -> None:
    """Any of the path's numbers may have a range; the food keeps to its line, limits and speed."""
    random = Random(seed)
    ranges: dict[str, Any] = {
        "food_limits_bl": random.choice([(0.5, 4.5), ((1.0, 2.0), 3.5), ((1.0, 2.0), (3.0, 4.0))]),
        "food_tilt_degrees": random.choice([0.0, 30.0, (-40.0, 20.0)]),
        "food_still_T": random.choice([2.0, (1.0, 3.0)]),
        "food_speed_bl": random.choice([0.3, (0.15, 0.5)]),
    }
    task = Predation(**SMALL, **ranges, food_direction="random")
    starts = task.sample_starts(200, torch.Generator().manual_seed(seed))
    path = {}
    for name, (low, high) in task.food_ranges.items():
        path[name] = starts.get(name, torch.full((200,), low)).float()
        edge = 0.1 * (high - low) + 1e-6
        assert low - 1e-6 <= path[name].min() <= low + edge
        assert high - edge <= path[name].max() <= high + 1e-6
    age = torch.full((200,), 10.0 * task.scales.period)
    ahead = (task.foresee_food(starts, age) / task.body_length).float()
    assert LEAD_T == controllers.LEAD_T
    later = task.locate_food(starts, age + 7 * LEAD_T * task.scales.period) / task.body_length
    torch.testing.assert_close(ahead[:, 7], later.float())
    away = ahead - torch.tensor([task.food_x_bl, task.food_y_bl])
    speeds, tilt = ahead.diff(dim=1).norm(dim=-1) / 0.25, path["food_tilt"].deg2rad()
    torch.testing.assert_close(speeds.amax(1), path["food_speed"], rtol=1e-4, atol=1e-5)
    upwards = torch.stack((-tilt.sin(), tilt.cos()), -1)[:, None]
    height = (away * upwards).sum(-1)
    torch.testing.assert_close(height.abs(), away.norm(dim=-1), rtol=1e-4, atol=1e-5)
    assert (height.amax(1) <= path["food_high"] - task.food_y_bl + 1e-5).all()
    assert (height.amin(1) >= path["food_low"] - task.food_y_bl - 1e-5).all()


def test_first_observation_is_the_food_relative_to_the_nose(small_task: Predation) -> None:
    env = begin(small_task, starts_at((6.5, 0.5), (5.5, 4.0)))
    expected = [[-4.0, 2.0, 20**0.5, -math.atan2(2, 4)], [-3.0, -1.5, 11.25**0.5, math.atan2(1, 2)]]
    torch.testing.assert_close(small_task.observe(env.now), torch.tensor(expected))


def test_continuous_action_sets_turn_and_tail_beat() -> None:
    beat = ContinuousFrequency(frequency_range=(0.5, 2.0))
    control = Turn(turn_degrees=10.0, beat=beat)
    task = Predation(**SMALL | {"wall_margin_bl": 0.25}, control=control)
    env = begin(task, starts_at(*[(6.5, 2.5)] * 3))
    assert task.scales.max_frequency == 2.0
    action = torch.tensor([[-1.0, -1.0], [0.0, 0.0], [0.5, 1.0]])
    earned = env.step(TensorDict({"action": action}, [3]))["next", "reward"]
    turned = torch.rad2deg(env.solver.body.heading - math.pi)
    torch.testing.assert_close(turned, torch.tensor([-10.0, 0.0, 5.0], dtype=torch.float64))
    beats = env.solver.body.frequency * task.scales.period
    torch.testing.assert_close(beats, torch.tensor([0.5, 1.25, 2.0], dtype=torch.float64))
    torch.testing.assert_close(earned[:, 0], beats.float())  # 1 per beat


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([[0.0, 1.1], [0.0, 0.0]], r"1.1.* in row 0: allowed is -1 to 1"),
        ([[0.0, 1.0], [math.nan, 0.0]], r"nan.* in row 1: allowed is -1 to 1"),
        ([[0.0], [0.0]], r"shape \(2, 1\): must hold 2 numbers"),
        ([1, 1], r"shape \(2,\): must hold 2 numbers"),
    ],
)
def test_invalid_continuous_action_is_refused(action: list, message: str) -> None:
    env = begin(Predation(**SMALL, control=CONTINUOUS), starts_at(*[(6.5, 2.5)] * 2))
    with pytest.raises(ValueError, match=message):
        env.step(TensorDict({"action": torch.tensor(action)}, [2]))


@pytest.mark.parametrize(
    ("settings", "x"),
    [({"capture_radius_bl": 0.1}, 2.7), ({"food_x_bl": 0.21, "capture_reward": 100.0}, 0.5)],
)
def test_capture_within_an_action_counts(settings: dict[str, float], x: float) -> None:
    """Gliding on, the fish would be past its food, or at the wall, at the end of the action."""
    task = Predation(**SMALL, **settings)
    env = begin(task, starts_at((x, 2.5)))
    after = act(env, KEEP)
    assert after["captured"].all() and after["reward"] == 1.0 + task.capture_reward
    distance, radius = after["observation"][0, 2], task.capture_radius_bl
    assert radius - 0.02 < distance <= radius  # the moment of capture, not the end
    assert env.solver.body.age < task.n_substeps


def test_wall_terminates_without_a_capture(small_task: Predation) -> None:
    upwards = starts_at((5.0, 4.5), heading=math.pi / 2)
    env = begin(small_task, torch.cat([upwards, starts_at((5.0, 2.5))]))
    after = act(env, KEEP, KEEP)
    assert after["terminated"].squeeze(-1).tolist() == [True, False]
    assert not after["captured"].any()
    assert after["reward"][0] in (-1.0, 1.0)
    assert 2.5 < env.now["clearance"][0] < small_task.wall_margin == 3.0
    assert env.solver.body.age[0] < env.solver.body.age[1] == 106.0  # it stops at its end


def test_environment_refuses_a_start_near_a_wall(small_task: Predation) -> None:
    with pytest.raises(ValueError, match=r"start 0.*too near the edge; it must keep 3 nodes"):
        make_flows(small_task, 1, starts=starts_at((6.0, 0.2)))
