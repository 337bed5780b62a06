"""Several learning fish: TorchRL's multi-agent layout, and one policy for each fish."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import check_env_specs
from torchrl.envs.utils import check_marl_grouping

from fishrl.envs import FlowEnv, Flows, make_env
from fishrl.envs.agents import EachFish, average_fish, split_fish
from tests.envs.conftest import SMALL, make_flows, reset_rows
from tests.envs.small_tasks import PairTask

pytestmark = pytest.mark.usefixtures("kinematic")


def act(env: FlowEnv, *actions: tuple[int, int]) -> TensorDict:
    agents = TensorDict({"action": torch.tensor(actions)}, [len(actions), 2])
    return env.step(TensorDict({"agents": agents}, env.batch_size))["next"]


@pytest.fixture
def flows() -> FlowEnv:
    env = make_flows(PairTask(**SMALL), 2)
    env.reset()
    return env


@pytest.mark.parametrize("is_continuous", [False, True])
def test_layout_is_torchrls_multi_agent_layout(is_continuous: bool) -> None:
    env = make_env(
        task=PairTask(**SMALL, is_continuous=is_continuous), flows=Flows(num_envs=3, compile=False)
    )
    check_env_specs(env, seed=0)
    check_marl_grouping(env.group_map, ["fish_0", "fish_1"])
    assert env.action_key == ("agents", "action") and env.reward_key == ("agents", "reward")
    rollout = env.rollout(12, break_when_any_done=False)
    after, agents = rollout["next"], rollout["agents"]
    assert agents.batch_size == (3, 12, 2)
    assert after["agents", "observation_stack"].shape == (3, 12, 2, 8)
    for name in ("reward", "episode_reward"):
        assert after["agents", name].shape == (3, 12, 2, 1)
    assert after["done"].shape == (3, 12, 1) and after["arrived"].shape == (3, 12, 2)
    assert after["done"].any()
    if not is_continuous:
        assert agents["action_mask"].gather(-1, agents["action"].unsqueeze(-1)).all()
        assert not agents["action_mask"].all()


def test_each_fish_has_its_own_command_and_reward(flows: FlowEnv) -> None:
    after = act(flows, (1, 1), (2, 0))["agents"]
    turned = torch.tensor([[0.0, 0.0], [0.2, -0.2]])
    torch.testing.assert_close(after["observation"][..., 1], math.pi + turned)
    straight, turned = after["reward"].squeeze(-1)
    assert straight[0] == straight[1] > turned[0]
    torch.testing.assert_close(turned[0], turned[1])


def test_diverged_flow_is_truncated_for_all_its_fish(flows: FlowEnv) -> None:
    flows.solver.bodies[1].position[1] = math.nan
    after = act(flows, (1, 1), (1, 1))
    assert after["diverged"].squeeze(-1).tolist() == [False, True]
    assert (after["agents", "reward"][1] == 0.0).all() and (after["agents", "reward"][0] > 0).all()
    assert after["agents", "observation"].isfinite().all()
    reset_rows(flows, False, True)
    assert not act(flows, (1, 1), (1, 1))["diverged"].any()


def test_illegal_action_is_named_with_its_row_and_fish(flows: FlowEnv) -> None:
    for _ in range(2):
        act(flows, (1, 1), (1, 0))
    with pytest.raises(ValueError, match="action = 0 in row 1, fish 1: legal is"):
        act(flows, (1, 1), (1, 0))
    with pytest.raises(ValueError, match=r"\(2, 1\), .*: must hold integers of shape \(2, 2\)"):
        flows.step(TensorDict({"agents": {"action": torch.ones(2, 1).long()}}, [2]))


def test_split_fish_repeats_entries_of_their_flow() -> None:
    data = make_env(task=PairTask(**SMALL), flows=Flows(num_envs=3, compile=False)).rollout(1)[:, 0]
    rows = split_fish(data)
    assert rows.shape == (6,) and "agents" not in rows.keys(True)
    for name in ("action", ("next", "reward")):
        own = data["next", "agents", "reward"] if "next" in name else data["agents", name]
        assert torch.equal(rows[name], own.flatten(0, 1))
    steps = data["next", "step_count"].repeat_interleave(2, 0)
    assert torch.equal(rows["next", "step_count"], steps)
    mean = average_fish(data["next"], "reward").squeeze(-1)
    torch.testing.assert_close(mean, rows["next", "reward"].view(3, 2).mean(1))


def test_policy_of_one_fish_decides_for_each_fish() -> None:
    def point(seen: TensorDict) -> TensorDict:
        assert seen.shape == (4,) and seen["step_count"].shape == (4, 1)
        return seen.set("action", torch.arange(4) % 3)

    state = make_env(task=PairTask(**SMALL), flows=Flows(num_envs=2, compile=False)).reset()
    assert EachFish(point)(state)["agents", "action"].tolist() == [[0, 1], [2, 0]]
