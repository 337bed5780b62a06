"""Series sensed within actions, entries kept between decisions, and inputs of transforms."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform, check_env_specs

from fishrl.envs import FlowEnv, make_env
from tests.envs.conftest import SMALL, make_flows, reset_rows
from tests.envs.conftest import act as act_with
from tests.envs.small_tasks import MemoryTask

pytestmark = pytest.mark.usefixtures("kinematic")


class AddHint(Transform):
    """Write ``hint`` and lengthen the observation by it."""

    def __init__(self) -> None:
        super().__init__(in_keys=["observation"], out_keys=["observation", "hint"])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        hint = next_tensordict["observation"][..., 0] * 0.1
        longer = torch.cat((next_tensordict["observation"], hint[..., None]), -1)
        return next_tensordict.set("hint", hint).set("observation", longer)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        spec, batch = observation_spec.clone(), observation_spec.shape
        spec["observation"], spec["hint"] = Unbounded((*batch, 3)), Unbounded(batch)
        return spec


@pytest.fixture
def env() -> FlowEnv:
    env = make_flows(MemoryTask(**SMALL), 2)
    env.reset()
    return env


def act(env: FlowEnv, *actions: int) -> TensorDict:
    return act_with(env, *actions, hint=[0.2, 0.2])


def test_last_sample_is_repeated_after_a_row_terminates(env: FlowEnv) -> None:
    env.solver.body.position[1, 0] = 34.0  # the nose reaches x = 1 L within the action
    after = act(env, 0, 0)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    assert (after["trace"][0].diff(dim=0) < 0).all()
    steps = after["trace"][1].diff(dim=0)
    assert (steps[0] < 0).all() and (steps[-1] == 0).all()


def test_row_that_terminates_before_the_first_sample_reports_its_last_moment(
    env: FlowEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows that share a launch move on after their end; what they sense then is ignored."""
    advance = env.solver.advance_
    monkeypatch.setattr(env.solver, "advance_", lambda num, rows: advance(num))
    env.solver.body.position[1, 0] = 27.6  # the nose reaches x = 1 L at once
    after = act(env, 0, 0)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    assert (after["trace"][1] == after["trace"][1, 0]).all()
    assert after["trace"][1, 0, 0] == env.now["x"][1].float()


def test_memory_persists_between_decisions_and_restarts_with_its_row(env: FlowEnv) -> None:
    act(env, 1, 0)
    assert act(env, 1, 1)["observation"][:, 1].tolist() == [2.0, 1.0]
    kept = env.now.clone()
    reset_rows(env, True, False)
    assert env.now["total"].tolist() == [0.0, 1.0]
    assert (env.now[1] == kept[1]).all()
    assert act(env, 0, 1)["total"].squeeze(-1).tolist() == [0.0, 2.0]


def test_transformed_inputs_reach_the_command_and_the_stack() -> None:
    task = MemoryTask(**SMALL)
    env = make_env(task=task, num_envs=2, compile=False, transforms=[AddHint()])
    assert env.observation_spec["trace"].shape == (2, 4, 3)
    check_env_specs(env, seed=0)
    state = env.reset()
    assert state["observation_stack"].shape == (2, 3 * task.num_stacked)
    heading = env.base_env.now["heading"].clone()
    env.step(state.set("action", torch.tensor([0, 1])))
    turned = env.base_env.now["heading"] - heading
    expected = torch.stack((torch.zeros(()), state["hint"][1])).double()
    torch.testing.assert_close(turned, expected, rtol=0, atol=1e-12)
