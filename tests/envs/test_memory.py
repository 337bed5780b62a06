"""Series sensed within actions, entries kept between decisions, and inputs of transforms."""

import pytest
from tensordict import TensorDict

from fishrl.envs import FlowEnv
from tests.envs.conftest import SMALL, make_flows, reset_rows
from tests.envs.conftest import act as act_with
from tests.envs.small_tasks import MemoryTask

pytestmark = pytest.mark.usefixtures("kinematic")


@pytest.fixture
def env() -> FlowEnv:
    env = make_flows(MemoryTask(**SMALL), 2)
    env.reset()
    return env


def act(env: FlowEnv, *actions: int) -> TensorDict:
    return act_with(env, *actions, hint=[0.2, 0.2])


@pytest.mark.parametrize(("x", "is_first"), [(34.0, False), (27.6, True)])
def test_last_sample_is_repeated_after_a_row_terminates(
    env: FlowEnv, monkeypatch: pytest.MonkeyPatch, x: float, is_first: bool
) -> None:
    """The nose reaches x = 1 L within the action, or before the first sample.

    Rows that share a launch move on after their end; what they sense then is ignored.
    """
    advance = env.solver.advance_
    monkeypatch.setattr(env.solver, "advance_", lambda num, rows: advance(num))
    env.solver.body.position[1, 0] = x
    after = act(env, 0, 0)
    assert after["terminated"].squeeze(-1).tolist() == [False, True]
    swims, ends = after["trace"].diff(dim=1)
    assert (swims < 0).all()
    assert (ends[0] < 0).all() == (not is_first) and (ends[-1] == 0).all()
    assert not is_first or after["trace"][1, 0, 0] == env.now["x"][1].float()


def test_memory_persists_between_decisions_and_restarts_with_its_row(env: FlowEnv) -> None:
    act(env, 1, 0)
    assert act(env, 1, 1)["observation"][:, 1].tolist() == [2.0, 1.0]
    kept = env.now.clone()
    reset_rows(env, True, False)
    assert env.now["total"].tolist() == [0.0, 1.0]
    assert (env.now[1] == kept[1]).all()
    assert act(env, 0, 1)["total"].squeeze(-1).tolist() == [0.0, 2.0]
