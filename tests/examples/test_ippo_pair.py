"""The example in the manner of TorchRL's multi-agent tutorial, on kinematic fish."""

from typing import Any

import pytest

from examples.ippo_pair import Settings, train
from fishrl.envs import Flows, PredationPair, make_env
from tests.envs.conftest import SMALL

pytestmark = pytest.mark.usefixtures("kinematic")
BRIEF: dict[str, Any] = {**SMALL, "control_interval_T": 0.25, "checks_per_action": 6}


@pytest.mark.parametrize("is_central", [False, True])
def test_ippo_trains_with_torchrl_modules(is_central: bool) -> None:
    task = PredationPair(**BRIEF, time_limit=3)
    settings = Settings(
        frames=32, frames_per_batch=16, num_epochs=2, batch_size=8, is_central=is_central
    )
    policy, returns = train(make_env(task=task, flows=Flows(num_envs=4, compile=False)), settings)
    assert len(returns) >= 2 * 4 * 2  # two fish in four flows, at least twice
    assert all(p.isfinite().all() for p in policy.parameters())
    rollout = make_env(task=task, flows=Flows(num_envs=1, compile=False)).rollout(3, policy)
    assert rollout["agents", "action"].shape[2:] == (2,)
