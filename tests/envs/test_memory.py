"""What a task senses within actions, keeps between them, and reads beside them."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform, check_env_specs

from fishrl.envs import FlowEnv, make_env
from tests.envs.conftest import SMALL
from tests.envs.memory_task import MemoryTask

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
        spec = observation_spec.clone()
        batch = spec.shape
        spec["observation"] = Unbounded((*batch, 3))
        spec["hint"] = Unbounded(batch)
        return spec


def make(num_envs: int, **arguments: float) -> FlowEnv:
    return FlowEnv(task=MemoryTask(**SMALL, **arguments), num_envs=num_envs, compile_flow=False)


def act(env: FlowEnv, *actions: int) -> TensorDict:
    rows = env.batch_size
    return env.step(
        TensorDict({"action": torch.tensor(actions), "hint": torch.full(rows, 0.2)}, rows)
    )["next"]


def test_after_a_rows_end_its_last_sample_is_repeated() -> None:
    env = make(2)
    env.reset()
    env.solver.body.position[1, 0] = 34.0  # the nose crosses the goal within the action
    after = act(env, 0, 0)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    assert (after["trace"][0].diff(dim=0) < 0).all()
    steps = after["trace"][1].diff(dim=0)
    assert (steps[0] < 0).all() and (steps[-1] == 0).all()


def test_a_row_that_ends_before_the_first_sample_reports_what_it_felt_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rows that share a launch move on after their end: what they feel then is nobody's."""
    env = make(2)
    advance = env.solver.advance_
    monkeypatch.setattr(env.solver, "advance_", lambda num, rows: advance(num))
    env.reset()
    env.solver.body.position[1, 0] = 27.6  # the nose crosses the goal at once
    after = act(env, 0, 0)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    assert (after["trace"][1] == after["trace"][1, 0]).all()
    assert after["trace"][1, 0, 0] == env.now["x"][1].float()


def test_memory_lasts_from_decision_to_decision_and_begins_anew_with_its_row() -> None:
    env = make(2)
    env.reset()
    act(env, 1, 0)
    assert act(env, 1, 1)["observation"][:, 1].tolist() == [2.0, 1.0]
    kept = env.now.clone()
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [2]))
    assert env.now["total"].tolist() == [0.0, 1.0]
    assert (env.now[1] == kept[1]).all()
    assert act(env, 0, 1)["total"].squeeze(-1).tolist() == [0.0, 2.0]


def test_what_a_transform_says_reaches_the_command_and_the_stack() -> None:
    task = MemoryTask(**SMALL)
    env = make_env(task=task, num_envs=2, compile=False, transforms=[AddHint()])
    state = env.reset()
    assert state["observation_stack"].shape == (2, 3 * task.num_stacked)
    heading = env.base_env.now["heading"].clone()
    env.step(state.set("action", torch.tensor([0, 1])))
    turned = env.base_env.now["heading"] - heading
    expected = torch.stack((torch.zeros(()), state["hint"][1])).double()
    torch.testing.assert_close(turned, expected, rtol=0, atol=1e-12)


def test_the_specs_hold_with_series_of_several_dimensions() -> None:
    env = make_env(task=MemoryTask(**SMALL), num_envs=3, compile=False, transforms=[AddHint()])
    assert env.observation_spec["trace"].shape == (3, 4, 3)
    check_env_specs(env, seed=0)
