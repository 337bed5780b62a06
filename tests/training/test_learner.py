"""What is remembered, and that remembering does not grow."""

from __future__ import annotations

import gc
import math
import re
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from fishrl.training import DiscreteSAC
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.metrics import measure_memory_mb
from tests.training.conftest import QUICK, Toy


def test_a_state_without_legal_action_is_refused(toy: Toy) -> None:
    training = toy.begin()
    batch = next(iter(training.collector)).reshape(-1)
    batch["next", "action_mask"][3] = False
    with pytest.raises(ValueError, match="a state has no legal action"):
        training.learner.store(batch)


def count_tensors() -> int:
    gc.collect()
    return sum(isinstance(thing, torch.Tensor) for thing in gc.get_objects())


def measure_own_memory_mb() -> float:
    """Without children, which earlier tests may have left."""
    found = re.search(r"\nAnonymous: *(\d+)", Path("/proc/self/smaps_rollup").read_text())
    assert found is not None
    return int(found[1]) / 1e3


@pytest.mark.parametrize("algorithm", [DiscreteSAC(), DRQN()], ids=["sac", "drqn"])
def test_memory_does_not_grow_with_frames(toy: Toy, algorithm: DiscreteSAC | DRQN) -> None:
    training = toy.begin(
        algorithm=algorithm,
        buffer_size=100,
        total_frames=160,
        task={"time_limit": 5},
        eval_frames=80,
        **QUICK,
    )
    training.run()
    tensors, megabytes = count_tensors(), measure_own_memory_mb()
    training.plan = replace(training.plan, total_frames=400)
    training.run()
    assert count_tensors() <= tensors + 5
    assert measure_own_memory_mb() < megabytes + 10.0  # allocators keep some; a frame is 5 kB


def test_memory_is_measured_while_threads_come_and_go() -> None:
    is_over = threading.Event()

    def come_and_go() -> None:
        while not is_over.is_set():
            thread = threading.Thread(target=int)
            thread.start()
            thread.join()

    busy = threading.Thread(target=come_and_go)
    busy.start()
    measured = [measure_memory_mb() for _ in range(100)]
    is_over.set()
    busy.join()
    assert not any(map(math.isnan, measured)) and min(measured) > 50.0
