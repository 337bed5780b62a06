"""Flows that advance in the processes of a Ray cluster, here one of this machine."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch

from fishrl.envs import PredationPair, make_env
from fishrl.training import begin, complete
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.cluster import ClusterCollector
from tests.envs.conftest import SMALL, move_kinematically
from tests.training.conftest import Toy, make_toy_plan


def test_invalid_numbers_of_collectors_are_refused(
    toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fishrl.training.resolve.find_spec", lambda name: None)
    for wrong, said in (
        ({"ray_collectors": 3}, "num_envs = 8: must be a multiple of"),
        ({"ray_collectors": -1}, "ray_collectors = -1: must be greater than or equal to 0"),
        ({"ray_collectors": 2}, "needs Ray: pip install 'ray"),
    ):
        with pytest.raises(ValueError, match=said):
            toy.begin(**wrong)
    assert not any(toy.folder.iterdir())


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    ray = pytest.importorskip("ray", reason="pip install 'fishrl[cluster]'")
    from fishrl.training.cluster import join_cluster

    assert join_cluster(2)
    assert not join_cluster(2)
    yield
    ray.shutdown()


@pytest.mark.cluster
@pytest.mark.usefixtures("cluster")
def test_cluster_run_resumes_exactly(toy: Toy) -> None:
    shared: dict[str, Any] = {
        "ray_collectors": 2,
        "algorithm": DQN(epsilon_frames=100),
        "task": {"divergence_rate": 0.05, "banned_action": 2},
    }
    whole = toy.begin(name="whole", **shared)
    complete(whole)
    counters, buffer = whole.counters, whole.learner.buffer
    assert counters.diverged > 0
    assert len(buffer) == counters.frames - counters.diverged == 240 - counters.diverged
    assert set(buffer[:]["action"].tolist()) == {0, 1}
    complete(toy.begin(name="parts", total_frames=120, **shared))
    complete(toy.reopen("parts", total_frames=240))
    assert toy.rows("parts") == toy.rows("whole")


@pytest.mark.cluster
@pytest.mark.usefixtures("cluster")
def test_collectors_use_the_newest_weights_and_unique_trajectory_ids(toy: Toy) -> None:
    training = toy.begin(ray_collectors=2, warmup_frames=0)
    batches = iter(training.collector)
    first = next(batches)
    assert first.batch_size == torch.Size([2, 4, 1])
    assert not torch.equal(first[0]["observation"], first[1]["observation"])
    assert len(first["collector", "traj_ids"].unique()) == 8
    with torch.no_grad():
        for weights in training.learner.explorer.parameters():
            weights.fill_(0.0)
    assert next(batches)["logits"].eq(0.0).all()
    training.close()


@pytest.mark.cluster
@pytest.mark.usefixtures("cluster")
def test_run_continues_exactly_after_a_lost_collector(
    toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    import ray

    complete(toy.begin(name="whole", ray_collectors=2))
    send, batches = ClusterCollector._send_weights, itertools.count()

    def send_and_lose(self: ClusterCollector) -> None:
        if next(batches) == 15:
            ray.kill(self._flows.remote_collectors[0])
        send(self)

    monkeypatch.setattr(ClusterCollector, "_send_weights", send_and_lose)
    complete(toy.begin(name="run", ray_collectors=2))
    assert next(batches) == 30 + 5 + 1  # five decisions since the last checkpoint
    assert toy.rows("run") == toy.rows("whole")


def make_gliding_env(**arguments: Any) -> Any:
    """Make an env whose fish move without a flow, in whichever process."""
    with pytest.MonkeyPatch.context() as patch:
        move_kinematically(patch)
        return make_env(**arguments)


@pytest.mark.cluster
@pytest.mark.usefixtures("cluster")
def test_epsilon_decays_with_env_frames_independent_of_the_number_of_fish(
    toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = {"ray_collectors": 2, "num_envs": 2, "warmup_frames": 2}
    plan = make_toy_plan(toy.folder, algorithm=DQN(epsilon_end=0.0, epsilon_frames=8), **few)
    pair = PredationPair(**SMALL, control_interval_T=0.25, checks_per_action=6)
    monkeypatch.setattr("fishrl.training.resolve.make_env", make_gliding_env)
    training = begin(replace(plan, task=pair))
    for _, _ in zip(range(3), training.collector, strict=False):
        pass
    chance: Any = training.learner.explorer[-1]  # type: ignore[index]
    assert float(chance.eps) == pytest.approx(1.0 - (3 * 2 - 2) / 8)
    training.close()


@pytest.mark.cluster
def test_a_cluster_that_is_too_small_is_refused(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray", reason="pip install 'fishrl[cluster]'")
    monkeypatch.setattr(ray, "is_initialized", lambda: True)
    monkeypatch.setattr(ray, "cluster_resources", lambda: {"CPU": 1.0})
    with pytest.raises(ValueError, match="the cluster has 1 CPUs, and each takes one"):
        toy.begin(ray_collectors=2)
