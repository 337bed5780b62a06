"""One-hot actions: TorchRL's own losses train on them, and masks hold."""

import pytest
import torch
from torch.nn.functional import one_hot
from torchrl.data import OneHot
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from fishrl.envs import AbstractTask, Flows, KarmanGait, OneHotAction, Predation, make_env
from tests.envs.conftest import CONTINUOUS, SMALL
from tests.envs.small_tasks import PairTask

pytestmark = pytest.mark.usefixtures("kinematic")


def make(task: AbstractTask) -> TransformedEnv:
    return make_env(task=task, flows=Flows(num_envs=2, compile=False), transforms=[OneHotAction()])


@pytest.fixture
def env() -> TransformedEnv:
    return make(KarmanGait(body_length=32, max_wall_speed=0.15))


def test_spec_is_one_hot_and_samples_are_legal(env: TransformedEnv) -> None:
    check_env_specs(env)
    assert isinstance(env.action_spec, OneHot)
    assert env.action_spec.shape[-1] == env.base_env.task.num_actions
    batch = env.rollout(12)
    assert (batch["action"].sum(-1) == 1).all()
    assert batch["action_mask"][batch["action"].bool()].all()


def test_index_of_the_set_entry_reaches_the_flow(env: TransformedEnv) -> None:
    state = env.reset()
    before, action = state["gear"].flatten(), one_hot(torch.tensor([2, 0]), 3)
    step = env.step(state.set("action", action))
    assert torch.equal(step["action"], action)  # a buffer keeps what the policy chose
    assert (step["next", "gear"].flatten() - before).tolist() == [1, -1]
    for wrong in (torch.full((2, 3), 0.3), torch.zeros(2, 3), torch.ones(2, 3)):
        with pytest.raises(ValueError, match="one entry of each action"):
            env.step(state.set("action", wrong))


def test_each_fish_has_its_own_one_hot_action() -> None:
    env = make(PairTask(**SMALL))
    check_env_specs(env)
    state = env.reset()
    assert env.full_action_spec["agents", "action"].shape == (2, 2, 3)
    action = one_hot(torch.tensor([[1, 2], [0, 1]]), 3)
    after = env.step(state.set(("agents", "action"), action))["next", "agents", "observation"]
    turns = after[..., 1] - state["agents", "observation"][..., 1]
    torch.testing.assert_close(turns, torch.tensor([[0.0, 0.2], [-0.2, 0.0]]))
    batch = env.rollout(12)["agents"]
    assert batch["action_mask"][batch["action"].bool()].all()


def test_continuous_actions_are_refused() -> None:
    with pytest.raises(ValueError, match="continuous actions"):
        check_env_specs(make(Predation(**SMALL, control=CONTINUOUS)))
