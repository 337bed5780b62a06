"""One-hot actions: TorchRL's own losses train on them, and masks hold."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import InteractionType, TensorDictModule
from torch import nn
from torch.nn.functional import one_hot
from torchrl.collectors import Collector
from torchrl.data import OneHot
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.modules import MLP, OneHotCategorical, ProbabilisticActor, QValueActor
from torchrl.objectives import DiscreteSACLoss, DQNLoss

from fishrl.envs import AbstractTask, KarmanGait, OneHotAction, Predation, make_env
from tests.envs.conftest import SMALL
from tests.envs.small_tasks import PairTask

pytestmark = pytest.mark.usefixtures("kinematic")


def make(task: AbstractTask) -> TransformedEnv:
    return make_env(task=task, num_envs=2, compile=False, transforms=[OneHotAction()])


@pytest.fixture
def env() -> TransformedEnv:
    return make(KarmanGait(body_length=32, max_wall_speed=0.15))


def make_mlp(env: TransformedEnv) -> MLP:
    num_inputs = env.observation_spec["observation_stack"].shape[-1]
    return MLP(num_inputs, env.action_spec.shape[-1], num_cells=[16])


def train(loss: Any, env: TransformedEnv, policy: nn.Module | None) -> TensorDict:
    """Take two gradient steps on 16 collected frames, and return these."""
    (batch,) = list(Collector(env, policy, frames_per_batch=16, total_frames=16))
    loss.make_value_estimator(gamma=0.99)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    for _ in range(2):
        losses = loss(batch.reshape(-1))
        total = sum(value for name, value in losses.items() if name.startswith("loss"))
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        assert total.isfinite()
    return batch


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


def test_torchrl_trains_discrete_sac_without_masks() -> None:
    """Its script knows no masks: all actions of the task are legal."""
    env = make(Predation(**SMALL))
    logits, values = (
        TensorDictModule(make_mlp(env), ["observation_stack"], [key])
        for key in ("logits", "action_value")
    )
    actor = ProbabilisticActor(
        logits, in_keys=["logits"], distribution_class=OneHotCategorical,
        default_interaction_type=InteractionType.RANDOM,
    )  # fmt: skip
    loss = DiscreteSACLoss(
        actor_network=actor, qvalue_network=values, num_actions=3, num_qvalue_nets=2,
        action_space=env.action_spec,
    )  # fmt: skip
    train(loss, env, None)


def test_torchrl_trains_dqn_on_legal_actions(env: TransformedEnv) -> None:
    policy = QValueActor(
        make_mlp(env), in_keys=["observation_stack"], spec=env.action_spec_unbatched,
        action_mask_key="action_mask",
    )  # fmt: skip
    batch = train(DQNLoss(policy, action_space=env.action_spec, delay_value=True), env, policy)
    assert batch["action_mask"][batch["action"].bool()].all()


def test_continuous_actions_are_refused() -> None:
    with pytest.raises(ValueError, match="continuous actions"):
        check_env_specs(make(Predation(**SMALL, action="continuous")))
