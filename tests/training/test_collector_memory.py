"""What a collector holds of the flows while an evaluation borrows its env."""

from pathlib import Path
from typing import Any

import pytest
from torch import Tensor

from fishrl.envs import Flows, Predation
from fishrl.training import Plan, open_run
from fishrl.training.loop import Training
from tests.envs.test_real_flow import TINY


def test_evaluation_holds_one_copy_of_the_flows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, copied, copy = Predation(**TINY), list[int](), Tensor.__deepcopy__

    def count(tensor: Tensor, memo: Any) -> Tensor:
        copied.append(tensor.numel() * tensor.element_size())
        return copy(tensor, memo)

    flows = Flows(num_envs=2, compile=False)
    training = Training(open_run(Plan(task=task, flows=flows, folder=str(tmp_path), hidden=(8,))))
    env = training.collector.env
    before = env.base_env.solver.state_dict()
    monkeypatch.setattr(Tensor, "__deepcopy__", count)
    with training.collector.lend_env():
        env.base_env.solver.advance_(2)
    training.close()
    assert sum(copied) < task.flow_config().num_bytes
    after = env.base_env.solver.state_dict()
    assert all(value.equal(after[name]) for name, value in before.items())
