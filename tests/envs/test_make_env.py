"""The environment with its transforms. No flow needed."""

from functools import partial

import pytest
import torch
from torchrl.envs import SerialEnv

from fishrl.envs import Predation, make_env
from tests.envs.conftest import SMALL, keep_straight, starts_at

pytestmark = pytest.mark.usefixtures("kinematic")


def test_the_stack_holds_the_last_observations_oldest_first_and_restarts_with_its_row() -> None:
    """Row 0 captures after some actions and starts anew, row 1 swims on."""
    task = Predation(**SMALL)
    env = make_env(
        task=task, num_envs=2, compile=False, starts=starts_at((3.8, 2.5), (7.5, 1.5), (7.0, 3.0))
    )
    rollout = env.rollout(8, policy=keep_straight, break_when_any_done=False)
    is_init = rollout["is_init"].squeeze(-1)
    assert is_init[0].nonzero().squeeze(-1).tolist()[0] == 0 and is_init[0].sum() == 2
    assert is_init[1].nonzero().squeeze(-1).tolist() == [0]
    for row in range(2):
        history: list[torch.Tensor] = []
        for t in range(8):
            observation = rollout["observation"][row, t]
            history = [observation] * 4 if is_init[row, t] else [*history[1:], observation]
            assert torch.equal(rollout["observation_stack"][row, t], torch.cat(history))
            # the true last stack of an episode, not the first of the next one
            after = torch.cat([*history[1:], rollout["next", "observation"][row, t]])
            assert torch.equal(rollout["next", "observation_stack"][row, t], after)


def test_an_episode_is_truncated_at_its_time_limit_and_not_terminated() -> None:
    task = Predation(**SMALL, time_limit=3)
    env = make_env(task=task, num_envs=2, compile=False)
    rollout = env.rollout(4, break_when_any_done=False)
    after = rollout["next"]
    assert after["truncated"].squeeze(-1).tolist() == [[False, False, True, False]] * 2
    assert torch.equal(after["done"], after["truncated"])
    assert not after["terminated"].any()
    assert after["step_count"].squeeze(-1).tolist() == [[1, 2, 3, 1]] * 2


def test_the_return_adds_up_over_an_episode_and_restarts_with_its_row() -> None:
    env = make_env(task=Predation(**SMALL), num_envs=2, compile=False, starts=starts_at((3.8, 2.5)))
    rollout = env.rollout(6, policy=keep_straight)
    assert rollout.shape == (2, 3)  # 1.3 L to the food, 0.25 L of it for free, at 0.4 L an action
    assert rollout["next", "episode_reward"][0].squeeze(-1).tolist() == [1.0, 2.0, 23.0]
    assert rollout["next", "captured"][0].squeeze(-1).tolist() == [False, False, True]


def test_flows_and_frame_stacks_are_saved_apart_and_go_on_in_an_equal_environment() -> None:
    make = partial(make_env, task=Predation(**SMALL), num_envs=2, compile=False)
    first, second = make(seed=1), make(seed=2)
    state = first.rollout(3)[:, -1]["next"].exclude("reward")
    second.reset()
    second.load_state_dict(first.state_dict())
    second.base_env.load_state_dict(first.base_env.state_dict())
    one, other = (env.step(keep_straight(state.clone()))["next"] for env in (first, second))
    assert (one == other).all()
    assert not torch.equal(one["observation_stack"], state["observation_stack"])


def test_environments_side_by_side_start_apart_once_they_are_seeded() -> None:
    make = partial(make_env, task=Predation(**SMALL), num_envs=2, compile=False)
    for seed, is_same in ((None, True), (3, False)):
        envs = SerialEnv(2, make)
        if seed is not None:
            envs.set_seed(seed)
        one, other = envs.reset()["observation"]
        assert torch.equal(one, other) is is_same
