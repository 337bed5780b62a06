"""What is in memory twice: flows while an evaluation borrows them, nothing of a checkpoint."""

import sys
from pathlib import Path
from typing import Any

import pytest
from torch import Tensor
from torchrl.data import LazyTensorStorage

from fishrl.envs import Flows, Predation
from fishrl.training import Plan, open_run
from fishrl.training.loop import Training
from tests.envs.test_real_flow import TINY
from tests.training.conftest import QUICK, Toy


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


@pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's list of mapped files")
def test_buffer_of_a_checkpoint_stays_in_its_file_until_it_is_copied(
    toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, load = [], LazyTensorStorage.load_state_dict

    def note(self: Any, state: Any) -> None:
        read.append(find_file(state["_storage"]["action"]))
        load(self, state)

    training = toy.begin(name="run", **QUICK)
    training.run()
    training.close()
    monkeypatch.setattr(LazyTensorStorage, "load_state_dict", note)
    again = toy.reopen("run", total_frames=320)
    assert read and all("checkpoints" in file for file in read)
    assert "checkpoints" not in find_file(again.learner.buffer[:]["action"])


def find_file(tensor: Tensor) -> str:
    """Return the file that a tensor's memory is mapped from, if any."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, *_, file = line.split(maxsplit=5)
        first, last = (int(end, 16) for end in span.split("-"))
        if first <= tensor.data_ptr() < last:
            return file
    return ""
