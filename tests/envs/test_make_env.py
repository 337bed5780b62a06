"""The environment with its transforms, without a flow."""

from typing import Any

import pytest
import torch

from fishrl.envs import Flows, Predation, make_env
from tests.envs.conftest import SMALL, keep_straight, make_flows, starts_at
from tests.envs.kinematic_solver import KinematicSolver

pytestmark = pytest.mark.usefixtures("kinematic")


def test_stack_holds_last_observations_of_its_episode() -> None:
    """Row 0 captures its food after some actions and is reset, row 1 swims on."""
    starts = starts_at((3.8, 2.5), (7.5, 1.5), (7.0, 3.0))
    env = make_env(task=Predation(**SMALL), flows=Flows(num_envs=2, compile=False), starts=starts)
    assert not hasattr(env.base_env, "group_map")  # entries of one fish are at the top level
    rollout = env.rollout(8, policy=keep_straight, break_when_any_done=False)
    is_init = rollout["is_init"].squeeze(-1)
    assert is_init.sum(1).tolist() == [2, 1] and is_init[:, 0].all()
    for row in range(2):
        history: list[torch.Tensor] = []
        for t in range(8):
            observation = rollout["observation"][row, t]
            history = [observation] * 4 if is_init[row, t] else [*history[1:], observation]
            assert torch.equal(rollout["observation_stack"][row, t], torch.cat(history))
            # the last stack of an episode, not the first of the next one
            after = torch.cat([*history[1:], rollout["next", "observation"][row, t]])
            assert torch.equal(rollout["next", "observation_stack"][row, t], after)


def test_time_limit_truncates_and_episode_rewards_are_sums() -> None:
    task = Predation(**SMALL, time_limit=3)
    starts = starts_at((5.0, 2.5), (3.8, 2.5))  # 1.3 L to the food, at 0.4 L an action
    env = make_env(task=task, flows=Flows(num_envs=2, compile=False), starts=starts)
    after = env.rollout(4, policy=keep_straight, break_when_any_done=False)["next"]
    flags = {"truncated": [False, False, True, False], "terminated": [False] * 4}
    for key, expected in (flags | {"step_count": [1, 2, 3, 1]}).items():
        assert after[key][0].squeeze(-1).tolist() == expected
    assert after["episode_reward"][:, :3, 0].tolist() == [[1.0, 2.0, 3.0], [1.0, 2.0, 23.0]]


def test_compile_reaches_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """TorchRL takes a keyword ``compile`` away before the constructor of an ``EnvBase`` sees it."""
    given = []

    def make_solver(*, compile: bool, **options: Any) -> KinematicSolver:
        given.append(compile)
        return KinematicSolver(**options)

    monkeypatch.setattr("fishrl.envs.flow_env.InPlaceSolver", make_solver)
    for compile in (False, True):
        make_env(task=Predation(**SMALL), flows=Flows(num_envs=1, compile=compile))
    make_flows(Predation(**SMALL), 1)
    assert given == [False, True, False]
