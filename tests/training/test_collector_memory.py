"""What is in memory twice: flows while an evaluation borrows them, nothing of a checkpoint."""

import ctypes
import gc
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torchrl.data import LazyTensorStorage

from fishrl.envs import Flows, Predation
from fishrl.training import Plan, open_run
from fishrl.training.loop import Training
from fishrl.training.opening import Opened
from tests.training.conftest import QUICK, Toy

#: Nodes of the fish, flows and levels of trainings that take some 100 MB.
FEW, MANY = ((64, 8, 1), (64, 12, 2)), ((24, 96, 1), (64, 16, 1), (150, 1, 1), (100, 16, 3))


def measure(folder: Path, length: int, num_envs: int, levels: int) -> tuple[Opened, int]:
    """Return a run and the bytes that it took, at most, to make, lend, save and read its flows."""
    task = Predation(body_length=length, levels=levels, reynolds=300.0, wall_margin_bl=0.2)
    flows, name = Flows(num_envs=num_envs, compile=False), f"{length}-{num_envs}-{levels}"
    plan = Plan(
        task=task,
        flows=flows,
        folder=str(folder),
        name=name,
        hidden=(8,),
        batch_size=9,
        buffer_size=9,
    )
    opened, before = open_run(plan), restart_peak()
    training = Training(opened)
    solver = training.collector.env.base_env.solver
    before_it = {name: value.sum() for name, value in solver.state_dict().items()}
    with training.collector.lend_env() as env:
        env.reset()
        solver.advance_(2**levels, rows=torch.arange(num_envs) == 0)
    training._save(training.folder.last)
    after = {name: value.sum() for name, value in solver.state_dict().items()}
    assert all(value.equal(after[name]) for name, value in before_it.items())
    del solver
    training.close()
    del training, env
    gc.collect()
    Training(open_run(folder / name, total_frames=10**7)).close()
    return opened, read_peak() - before


def restart_peak() -> int:
    """Return the resident memory, bytes, and let the largest be counted from here."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # what it keeps of former sizes
    Path("/proc/self/clear_refs").write_text("5")
    return read_peak()


def read_peak() -> int:
    found = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    assert found
    return 1024 * int(found[1])


def compare(folder: Path, size: str) -> None:
    """Write what a run of a size took and what its check counts."""
    measure(folder, 24, 2, 1)  # imports
    opened, peak = measure(folder, *json.loads(size))
    found = peak, sum(opened.count_bytes()["cpu"].values())
    (folder / "found.json").write_text(json.dumps(found))


@pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's peak of a process")
@pytest.mark.parametrize("size", [*FEW, *(pytest.param(s, marks=pytest.mark.slow) for s in MANY)])
def test_check_of_memory_counts_what_a_training_takes(size: Any, tmp_path: Path) -> None:
    """In a process of its own, whose allocator gives back each tensor when it is freed."""
    env = os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"}
    code = f"from {__name__} import *; compare(Path(sys.argv[1]), sys.argv[2])"
    command = [sys.executable, "-c", code, str(tmp_path), json.dumps(size)]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    peak, said = json.loads((tmp_path / "found.json").read_text())
    own = 0.35e6 * size[1] * size[2]  # of Python: views of each flow on each grid
    assert 0.9 * said < peak < 1.05 * said + own


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
