"""TorchRL's own losses train on one-hot actions, and masks hold."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import InteractionType, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, OneHot, TensorDictReplayBuffer
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.modules import MLP, OneHotCategorical, ProbabilisticActor, QValueActor
from torchrl.objectives import DiscreteSACLoss, DQNLoss, SoftUpdate

from fishrl.envs import KarmanGait, OneHotAction, Predation, make_env
from tests.envs.conftest import SMALL
from tests.envs.small_tasks import PairTask

pytestmark = pytest.mark.usefixtures("kinematic")


@pytest.fixture
def env() -> TransformedEnv:
    task = KarmanGait(body_length=32, max_wall_speed=0.15)
    return make_env(task=task, num_envs=2, compile=False, transforms=[OneHotAction()])


def collect(env: TransformedEnv, policy: nn.Module | None) -> TensorDict:
    collector = Collector(env, policy, frames_per_batch=16, total_frames=16)
    (batch,) = list(collector)
    return batch.reshape(-1)


def test_the_spec_is_one_hot_and_samples_are_legal(env: TransformedEnv) -> None:
    check_env_specs(env)
    assert isinstance(env.action_spec, OneHot)
    num_actions = env.action_spec.shape[-1]
    assert num_actions == env.base_env.task.num_actions
    batch = env.rollout(12)
    assert (batch["action"].sum(-1) == 1).all()
    assert batch["action_mask"][batch["action"].bool()].all()


def test_the_index_of_the_entry_that_is_set_reaches_the_flow(env: TransformedEnv) -> None:
    state = env.reset()
    before = state["gear"].flatten()
    one_hot = nn.functional.one_hot(torch.tensor([2, 0]), 3)
    step = env.step(state.set("action", one_hot))
    assert torch.equal(step["action"], one_hot)  # what a buffer keeps is what the policy chose
    assert (step["next", "gear"].flatten() - before).tolist() == [1, -1]
    for wrong in (torch.full((2, 3), 0.3), torch.zeros(2, 3), torch.ones(2, 3)):
        with pytest.raises(ValueError, match="one entry of each action"):
            env.step(state.set("action", wrong))


def test_each_fish_has_its_own_one_hot_action() -> None:
    task = PairTask(**SMALL)
    env = make_env(task=task, num_envs=2, compile=False, transforms=[OneHotAction()])
    check_env_specs(env)
    state = env.reset()
    assert env.full_action_spec["agents", "action"].shape == (2, 2, 3)
    one_hot = nn.functional.one_hot(torch.tensor([[1, 2], [0, 1]]), 3)
    after = env.step(state.set(("agents", "action"), one_hot))["next", "agents", "observation"]
    turns = after[..., 1] - state["agents", "observation"][..., 1]
    torch.testing.assert_close(turns, torch.tensor([[0.0, 0.2], [-0.2, 0.0]]))
    batch = env.rollout(12)["agents"]
    assert batch["action_mask"][batch["action"].bool()].all()


def test_torchrl_trains_discrete_sac_where_all_actions_are_legal() -> None:
    """Its script knows no masks."""
    env = make_env(
        task=Predation(**SMALL),
        num_envs=2,
        compile=False,
        transforms=[OneHotAction()],
    )
    num_inputs = env.observation_spec["observation_stack"].shape[-1]
    num_actions = env.action_spec.shape[-1]
    actor = ProbabilisticActor(
        TensorDictModule(
            MLP(num_inputs, num_actions, num_cells=[16]), ["observation_stack"], ["logits"]
        ),
        in_keys=["logits"],
        distribution_class=OneHotCategorical,
        default_interaction_type=InteractionType.RANDOM,
    )
    qvalue = TensorDictModule(
        MLP(num_inputs, num_actions, num_cells=[16]), ["observation_stack"], ["action_value"]
    )
    loss = DiscreteSACLoss(
        actor_network=actor, qvalue_network=qvalue, num_actions=num_actions, num_qvalue_nets=2,
        action_space=env.action_spec,
    )  # fmt: skip
    loss.make_value_estimator(gamma=0.99)
    target = SoftUpdate(loss, eps=0.99)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(64), batch_size=8)
    buffer.extend(collect(env, None))
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    for _ in range(2):
        losses = loss(buffer.sample())
        total = losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        target.step()
        assert total.isfinite()


def test_torchrl_trains_dqn_on_it(env: TransformedEnv) -> None:
    num_inputs = env.observation_spec["observation_stack"].shape[-1]
    policy = QValueActor(
        MLP(num_inputs, env.action_spec.shape[-1], num_cells=[16]),
        in_keys=["observation_stack"],
        spec=env.action_spec_unbatched,
        action_mask_key="action_mask",
    )
    loss = DQNLoss(policy, action_space=env.action_spec, delay_value=True)
    loss.make_value_estimator(gamma=0.99)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    batch = collect(env, policy)
    assert batch["action_mask"][batch["action"].bool()].all()
    for _ in range(2):
        value = loss(batch)["loss"]
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
        assert value.isfinite()


def test_continuous_actions_are_refused() -> None:
    task = Predation(**SMALL, action="continuous")
    with pytest.raises(ValueError, match="continuous actions"):
        check_env_specs(make_env(task=task, num_envs=1, compile=False, transforms=[OneHotAction()]))
