"""Stable-Baselines3 learns with kinematic fish."""

from typing import Any

import numpy as np
import pytest
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor
from tensordict.nn import TensorDictModule

from fishrl.envs import Flows, Predation, make_env
from fishrl.envs.control import Turn
from fishrl.wrappers.stable_baselines import FlowVecEnv, Learned
from tests.envs.conftest import CONTINUOUS, SMALL
from tests.envs.small_tasks import MaskedTask

pytestmark = pytest.mark.usefixtures("kinematic")


def make(task: Any = None, *, num_envs: int = 2) -> FlowVecEnv:
    task = task or Predation(**SMALL, time_limit=3)
    return FlowVecEnv(make_env(task=task, flows=Flows(num_envs=num_envs, compile=False)))


def keep(num: int = 2) -> np.ndarray:
    return np.ones(num, dtype=np.int64)


def test_ended_row_returns_terminal_observation() -> None:
    envs = make()
    envs.seed(0)
    first = envs.reset()
    envs.seed(0)
    assert np.array_equal(envs.reset(), first)
    for _ in range(2):
        _, _, dones, infos = envs.step(keep())
        assert not dones.any()
        assert all("terminal_observation" not in info for info in infos)
    observations, _, dones, infos = envs.step(keep())
    assert dones.tolist() == [info["TimeLimit.truncated"] for info in infos] == [True, True]
    assert [info["step_count"] for info in infos] == [3, 3]
    assert [info["step_count"] for info in envs.reset_infos] == [0, 0]
    assert [info["ending"] for info in infos] == ["time is over"] * 2
    assert not any("ending" in info for info in envs.reset_infos)
    assert not np.array_equal(infos[1]["terminal_observation"], observations[1])


def test_attributes_and_methods_are_per_row() -> None:
    envs = make(num_envs=3)
    envs.reset()
    assert envs.get_attr("num_envs", indices=[0, 2]) == [3, 3]
    assert not envs.has_attr("nothing_there")
    assert np.stack(envs.env_method("action_masks", indices=1)).tolist() == [[True] * 3]
    assert envs.env_is_wrapped(VecMonitor) == [False] * 3
    with pytest.raises(ValueError, match="rows share one environment"):
        envs.set_attr("task", None)
    envs.set_options({"reset_masc": [True]})
    with pytest.raises(ValueError, match="reset_masc"):
        envs.reset()
    envs.close()
    with pytest.raises(RuntimeError, match="closed"):
        envs.vector.flows.solver.advance_(2)


@pytest.mark.learning
@pytest.mark.parametrize(("kind", "control"), [(DQN, Turn()), (PPO, CONTINUOUS)])
def test_algorithms_without_masks_learn(kind: type, control: Turn) -> None:
    envs = make(Predation(**SMALL, time_limit=3, control=control), num_envs=4)
    short = {"n_steps": 16, "batch_size": 16} if kind is PPO else {"learning_starts": 16}
    model = kind("MlpPolicy", VecMonitor(envs), seed=0, device="cpu", **short)
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(64)
    assert model.num_timesteps >= 64
    assert max(episode["l"] for episode in model.ep_info_buffer) == 3
    after = list(model.policy.parameters())
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert all(p.isfinite().all() for p in after)


@pytest.mark.learning
def test_maskable_ppo_takes_legal_actions() -> None:
    envs = make(MaskedTask(**SMALL, time_limit=6), num_envs=3)
    model = MaskablePPO("MlpPolicy", envs, n_steps=16, batch_size=16, seed=0, device="cpu")
    model.learn(96)  # an illegal action would end it with an error
    assert model.num_timesteps >= 96
    assert (~envs.vector.action_masks()).any() or model.rollout_buffer.action_masks.min() == 0


def test_policy_acts_legally_in_evaluation() -> None:
    envs = make(MaskedTask(**SMALL, time_limit=6), num_envs=2)
    policy = TensorDictModule(lambda mask: mask.long().argmax(-1), ["action_mask"], ["action"])
    _, lengths = evaluate_policy(
        Learned(policy, envs), VecMonitor(envs), n_eval_episodes=2, return_episode_rewards=True
    )
    assert max(lengths) == 6  # an illegal action would end it with an error
