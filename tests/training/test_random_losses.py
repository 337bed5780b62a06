"""A training whose machines are killed at random, again and again."""

from __future__ import annotations

import logging
import random
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils import _pytree as pytree

from fishrl.files import load_tensors
from fishrl.training import complete
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.cluster import ClusterCollector, join_cluster
from tests.training.conftest import Toy, read_rows

logger = logging.getLogger(__name__)

KILLS = 20
RUNS = "whole", "run"
#: What asks the machines for something: weights are put and set, batches fetched, states saved.
ASKING = sorted({*filter(lambda name: name[:2] != "__", vars(ClusterCollector))} - {"shutdown"})
SETTINGS: dict[str, Any] = {
    "ray_collectors": 2,
    "algorithm": DQN(epsilon_frames=100),
    "task": {"divergence_rate": 0.05, "banned_action": 2},
    "baselines": (),
    "total_frames": 640,
    "checkpoint_frames": 8,
    "eval_frames": 320,
}


class Killer:
    """Kills one of two machines a moment after a call, chosen at random, and adds another one."""

    def __init__(self, machines: Any, seed: int) -> None:
        self._machines, self._draw = machines, random.Random(seed)
        self._thread: threading.Thread | None = None
        self._calls = self._draw.randrange(4)
        self.killed: Counter[str] = Counter()

    def notice(self, name: str) -> None:
        is_busy = self._thread is not None and self._thread.is_alive()
        if is_busy or self.killed.total() >= KILLS:
            return
        self._calls -= 1
        if self._calls < 0:
            self.killed[name] += 1
            self._calls = self._draw.randrange(12)
            logger.warning("kill %d after %s", self.killed.total(), name)
            lost = self._draw.choice(self._machines.list_all_nodes()[1:])
            add_machine(self._machines)  # takes its place
            self._thread = threading.Thread(
                target=self._kill, args=(lost, 0.05 * self._draw.random())
            )
            self._thread.start()

    def _kill(self, lost: Any, seconds: float) -> None:
        time.sleep(seconds)
        self._machines.remove_node(lost, allow_graceful=False)

    def wait(self) -> None:
        if self._thread is not None:
            self._thread.join()


def add_machine(machines: Any) -> None:
    """Add a machine; where others compute, Ray's 30 seconds for it may be over too soon."""
    while True:
        try:
            machines.add_node(num_cpus=1, include_log_monitor=False)
            return
        except Exception as error:
            if "timed out during startup" not in str(error):
                raise
            logger.warning("%s", error)


@pytest.mark.slow
@pytest.mark.cluster
@pytest.mark.timeout(7200)  # some twenty starts of two processes each, where others compute too
def test_training_whose_machines_are_killed_at_random_ends_as_an_undisturbed_one(
    toy: Toy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import ray
    from ray.cluster_utils import Cluster

    head = {"include_log_monitor": False, "include_dashboard": False, "no_monitor": True}
    machines = Cluster(initialize_head=True, head_node_args={**head, "num_cpus": 0})
    for _ in range(2):
        add_machine(machines)
    monkeypatch.setenv("RAY_ADDRESS", machines.address)
    try:
        assert join_cluster(2)
        whole = toy.begin(name="whole", **SETTINGS)
        complete(whole)
        killer, attempts = Killer(machines, seed=0), 0
        for name in ASKING:
            watch(monkeypatch, name, killer)
        while not (tmp_path / "run" / "summary.json").is_file():
            attempts += 1
            assert attempts <= 3 * KILLS
            try:
                training = toy.reopen("run") if attempts > 1 else toy.begin(name="run", **SETTINGS)
                complete(training)
            except (ChildProcessError, ValueError) as error:
                said = str(error)
                if "the cluster has" not in said and "is lost" not in said:
                    raise
            killer.wait()
        logger.warning("%d commands, killed after %s", attempts, dict(killer.killed))
        assert killer.killed.total() == KILLS
        assert toy.rows("run") == read_rows(tmp_path / "whole")
        for part in ("loss", "optimiser"):
            ends = [read_part(tmp_path / name / "checkpoints" / "last", part) for name in RUNS]
            assert ends[0], part
            assert all(torch.equal(*pair) for pair in zip(*ends, strict=True)), part
    finally:
        ray.shutdown()
        machines.shutdown()


def read_part(checkpoint: Path, name: str) -> list[torch.Tensor]:
    """Return the tensors of a component of a checkpoint."""
    file = Checkpoint.read(checkpoint).files[name]
    leaves = pytree.tree_leaves(load_tensors(file, what=name, remedy=""))
    return [leaf for leaf in leaves if isinstance(leaf, torch.Tensor)]


def watch(monkeypatch: pytest.MonkeyPatch, name: str, killer: Killer) -> None:
    """Let the killer notice each call of a method."""
    method = getattr(ClusterCollector, name)

    def call(self: ClusterCollector, *arguments: Any, **named: Any) -> Any:
        killer.notice(name)
        return method(self, *arguments, **named)

    monkeypatch.setattr(ClusterCollector, name, call)
