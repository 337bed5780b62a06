"""Tasks on levels: what is rounded, what is refused, and one decision of the real flow."""

from typing import Any

import pytest
import torch

from fishrl.envs import FlowEnv, Flows, Predation
from tests.envs.conftest import act

TASK: dict[str, Any] = {
    "body_length": 16,
    "reynolds": 400.0,
    "levels": 2,
    "wall_margin_bl": 0.7,
    "checks_per_action": 20,
}


@pytest.mark.parametrize("levels", [2, 3])
def test_period_actions_and_domain_are_rounded_to_levels(levels: int) -> None:
    task = Predation(**TASK | {"levels": levels, "body_length": 32})
    config = task.flow_config()
    assert task.scales.period % 2**levels == 0 and task.n_substeps == task.scales.period
    assert (config.width, config.height) == (321, 161)
    assert config.levels == levels


def test_environment_acts_and_resumes_on_levels() -> None:
    flows = Flows(num_envs=2, compile=False, num_workers=0)
    env, twin = (FlowEnv(task=Predation(**TASK), flows=flows, seed=1) for _ in range(2))
    env.reset()
    after = act(env, 1, 1)
    assert after["observation"].isfinite().all() and not after["terminated"].any()
    assert env.solver.body.age.tolist() == [float(env.task.n_substeps)] * 2
    twin.reset()
    twin.load_state_dict(env.state_dict())
    pairs = zip(env.solver.state_dict().items(), twin.solver.state_dict().values(), strict=True)
    assert [name for (name, one), other in pairs if not torch.equal(one, other)] == []
