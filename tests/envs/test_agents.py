"""Several fish that learn: TorchRL's multi-agent layout, and one policy for each fish."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import check_env_specs
from torchrl.envs.utils import check_marl_grouping

from fishrl.envs import FlowEnv, Predation, make_env
from fishrl.envs.agents import EachFish, average_fish, split_fish
from fishrl.envs.extensions import HasFlowLabels
from fishrl.modules import RandomPolicy
from tests.envs.conftest import SMALL, make_flows, reset_rows
from tests.envs.pair_task import PairTask

pytestmark = pytest.mark.usefixtures("kinematic")


def act(env: FlowEnv, *actions: tuple[int, int]) -> TensorDict:
    agents = TensorDict({"action": torch.tensor(actions)}, [len(actions), 2])
    return env.step(TensorDict({"agents": agents}, env.batch_size))["next"]


@pytest.mark.parametrize("is_continuous", [False, True])
def test_the_layout_is_that_of_torchrls_multi_agent_environments(is_continuous: bool) -> None:
    env = make_env(task=PairTask(**SMALL, is_continuous=is_continuous), num_envs=3, compile=False)
    check_env_specs(env, seed=0)
    check_marl_grouping(env.group_map, ["fish_0", "fish_1"])
    assert env.group_map == {"agents": ["fish_0", "fish_1"]}
    assert env.action_key == ("agents", "action") and env.reward_key == ("agents", "reward")
    rollout = env.rollout(12, break_when_any_done=False)
    assert rollout["agents"].batch_size == (3, 12, 2)
    after = rollout["next"]
    assert after["agents", "observation_stack"].shape == (3, 12, 2, 8)
    assert (
        after["agents", "reward"].shape == after["agents", "episode_reward"].shape == (3, 12, 2, 1)
    )
    assert after["done"].shape == (3, 12, 1) and after["arrived"].shape == (3, 12, 2)
    assert after["done"].any()
    if not is_continuous:
        chosen = rollout["agents", "action"].unsqueeze(-1)
        assert rollout["agents", "action_mask"].gather(-1, chosen).all()
        assert not rollout["agents", "action_mask"].all()


def test_one_fish_keeps_its_entries_at_the_top() -> None:
    env = make_env(task=Predation(**SMALL), num_envs=2, compile=False)
    assert not hasattr(env.base_env, "group_map")
    assert {"observation", "observation_stack", "action_mask"} <= set(env.reset().keys())


def test_each_fish_is_commanded_observed_and_rewarded_by_itself() -> None:
    env = make_flows(PairTask(**SMALL), 2)
    env.reset()
    after = act(env, (1, 1), (2, 0))["agents"]
    torch.testing.assert_close(
        after["observation"][..., 1], math.pi + torch.tensor([[0.0, 0.0], [0.2, -0.2]])
    )
    straight, turned = after["reward"].squeeze(-1)
    assert straight[0] == straight[1] > turned[0]
    torch.testing.assert_close(turned[0], turned[1])


def test_a_partial_reset_keeps_the_stacks_and_returns_of_other_rows() -> None:
    env = make_env(task=PairTask(**SMALL), num_envs=2, compile=False)
    before = env.rollout(2, policy=EachFish(RandomPolicy(seed=0)))[:, -1]["next"]
    state = env.reset(
        before.select("agents", "done", "terminated", "truncated").set(
            "_reset", torch.tensor([[False], [True]])
        )
    )["agents"]
    for name in ("observation_stack", "episode_reward"):
        assert torch.equal(state[name][0], before["agents", name][0])
    assert (state["episode_reward"][1] == 0.0).all()
    stacks = state["observation_stack"][1].unflatten(-1, (-1, 2))
    assert (stacks == stacks[:, :1]).all()


def test_a_flow_that_diverges_is_truncated_for_all_its_fish() -> None:
    env = make_flows(PairTask(**SMALL), 2)
    env.reset()
    env.solver.bodies[1].position[1] = math.nan
    after = act(env, (1, 1), (1, 1))
    assert after["diverged"].squeeze(-1).tolist() == [False, True]
    assert (after["agents", "reward"][1] == 0.0).all() and (after["agents", "reward"][0] > 0).all()
    assert after["agents", "observation"].isfinite().all()
    reset_rows(env, False, True)
    assert not act(env, (1, 1), (1, 1))["diverged"].any()


def test_an_illegal_action_is_named_with_its_row_and_fish() -> None:
    env = make_flows(PairTask(**SMALL), 2)
    env.reset()
    for _ in range(2):
        act(env, (1, 1), (1, 0))
    with pytest.raises(ValueError, match="action = 0 in row 1, fish 1: legal is"):
        act(env, (1, 1), (1, 0))
    with pytest.raises(ValueError, match=r"\(2, 1\), .*: must hold integers of shape \(2, 2\)"):
        env.step(TensorDict({"agents": {"action": torch.ones(2, 1).long()}}, [2]))


class LabelledPair(PairTask, HasFlowLabels):
    """Two fish in one of two flows."""

    flow_labels = [{"speed_bl": 1.0}, {"speed_bl": 2.0}]


def test_flow_labels_are_refused_for_several_fish() -> None:
    with pytest.raises(ValueError, match=r"LabelledPair has .* several fish"):
        make_env(task=LabelledPair(**SMALL), num_envs=1, recognition="oracle")


def test_rows_of_each_fish_hold_its_own_entries_and_those_of_its_flow() -> None:
    env = make_env(task=PairTask(**SMALL), num_envs=3, compile=False)
    data = env.rollout(1)[:, 0]
    rows = split_fish(data)
    assert rows.shape == (6,) and "agents" not in rows.keys(True)
    for row in range(6):
        flow, fish = divmod(row, 2)
        assert torch.equal(rows["action"][row], data["agents", "action"][flow, fish])
        assert torch.equal(
            rows["next", "reward"][row], data["next", "agents", "reward"][flow, fish]
        )
        assert torch.equal(rows["next", "step_count"][row], data["next", "step_count"][flow])
    mean = average_fish(data["next"], "reward").squeeze(-1)
    torch.testing.assert_close(mean, rows["next", "reward"].view(3, 2).mean(1))


def test_a_policy_of_one_fish_decides_for_each_fish_as_if_it_were_alone() -> None:
    env = make_env(task=PairTask(**SMALL), num_envs=2, compile=False)
    state = env.reset()

    def point(seen: TensorDict) -> TensorDict:
        assert seen.shape == (4,) and seen["step_count"].shape == (4, 1)
        return seen.set("action", torch.arange(4) % 3)

    acted = EachFish(point)(state)
    assert acted["agents", "action"].tolist() == [[0, 1], [2, 0]]
