"""Predation by two fish: observations, rewards, contact, and the bad input it refuses."""

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import FlowEnv, PredationPair
from tests.envs.conftest import SMALL, make_flows

pytestmark = pytest.mark.usefixtures("kinematic")
KEEP = 1
NORTH, SOUTH, WEST = 0.5 * math.pi, -0.5 * math.pi, math.pi


def start_at(
    *heads: tuple[float, float], headings: tuple[float, float] = (WEST, WEST)
) -> TensorDict:
    """One start of two fish with noses at ``heads``, in body lengths of the small task."""
    return TensorDict(
        {
            "head": torch.tensor([heads], dtype=torch.float64) * SMALL["body_length"],
            "heading": torch.tensor([headings], dtype=torch.float64),
            "food_direction": torch.ones(1, dtype=torch.float64),
        },
        [1],
    )


def begin(starts: TensorDict, **settings: Any) -> FlowEnv:
    env = make_flows(PredationPair(**SMALL, **settings), 1, starts=starts)
    env.reset()
    return env


def act(env: FlowEnv, *actions: int) -> TensorDict:
    agents = TensorDict({"action": torch.tensor([actions])}, [1, 2])
    return env.step(TensorDict({"agents": agents}, [1]))["next"][0]


def test_observation_is_the_other_fish_and_the_food() -> None:
    env = begin(start_at((5.5, 2.0), (6.0, 3.5), headings=(WEST, NORTH)))
    seen = env.task.observe(env.now)[0]
    gap = math.hypot(0.5, 1.5)
    torch.testing.assert_close(seen[0, :3], torch.tensor([0.5, 1.5, gap]))
    torch.testing.assert_close(seen[1, :3], torch.tensor([-0.5, -1.5, gap]))
    # fish 0 looks west and has the other behind on its right, fish 1 looks north, away from it
    assert -math.pi < float(seen[0, 3]) < -0.5 * math.pi
    assert float(seen[1, 3]) > 0.5 * math.pi
    torch.testing.assert_close(seen[0, 4:6], torch.tensor([-3.0, 0.5]))
    torch.testing.assert_close(seen[1, 4:6], torch.tensor([-3.5, -1.0]))


def test_capture_rewards_one_fish_and_ends_both_episodes() -> None:
    env = begin(start_at((2.9, 2.5), (6.0, 3.5)))
    after = act(env, KEEP, KEEP)
    assert after["terminated"].item() and after["captured"].item()
    assert after["caught"].tolist() == [True, False] and not after["contact"].item()
    assert after["agents", "reward"].squeeze(-1).tolist() == [21.0, 1.0]


def test_contact_ends_the_episode_before_fish_overlap() -> None:
    env = begin(start_at((6.0, 2.4), (6.0, 2.8), headings=(NORTH, SOUTH)), contact_penalty=7.0)
    after = act(env, KEEP, KEEP)
    assert after["terminated"].item() and after["contact"].item()
    assert 0.0 < float(env.now["gap"]) < 0.15 * SMALL["body_length"]
    assert not after["caught"].any()
    rewards = after["agents", "reward"].squeeze(-1)
    assert rewards.max() < -5.0
