"""The example in the manner of CleanRL, on kinematic fish."""

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor

from examples.ppo_in_one_file import Settings, make_fish, train
from fishrl.envs import Flows, Predation
from tests.envs.conftest import SMALL
from tests.envs.small_tasks import MaskedTask

pytestmark = [pytest.mark.usefixtures("kinematic"), pytest.mark.learning]
BRIEF: dict[str, Any] = {**SMALL, "control_interval_T": 0.25, "checks_per_action": 12}


class Eager(MaskedTask):
    """Beat fast: the reward is the tail beat, and the fastest is masked once it is reached."""

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        return {"beats": now["frequency"] * self.scales.period}

    def is_terminated(self, now: TensorDictBase) -> Tensor:
        return torch.zeros_like(now["x"], dtype=torch.bool)


def test_ppo_learns_the_fastest_beat() -> None:
    """Up and down by turns is the best: 1.5, 2, 1.5, ... beats; a random fish has 1.25."""
    envs = make_fish(Eager(**BRIEF, time_limit=4), flows=Flows(num_envs=8, compile=False))
    settings = Settings(total_steps=1536, num_steps=16, learning_rate=5e-3, entropy_weight=0.0)
    agent, returns = train(envs, settings)
    assert np.mean(returns[:64]) < 5.8
    assert np.mean(returns[-64:]) > 6.7  # of 7
    assert all(p.isfinite().all() for p in agent.parameters())


def test_one_seed_gives_one_agent() -> None:
    agents = []
    for _ in range(2):
        envs = make_fish(Predation(**BRIEF, time_limit=3), flows=Flows(num_envs=2, compile=False))
        agents.append(train(envs, Settings(total_steps=32, num_steps=8))[0])
    for a, b in zip(*(agent.parameters() for agent in agents), strict=True):
        assert torch.equal(a, b)
