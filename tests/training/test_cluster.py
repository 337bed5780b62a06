"""Flows that advance in the processes of a Ray cluster, here one of this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments import settings
from experiments.settings import ConfigError, TrainConfig
from experiments.sweeps.runs import read_run
from experiments.train import finish, set_up
from fishrl.training.loop import Training
from fishrl.training.run_folder import RunFolder
from tests.experiments.test_sweep_jobs import rows_of
from tests.training.toy_fish import make_toy_env

MakeConfig = Callable[..., TrainConfig]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"num_envs": 8, "ray_collectors": 3}, "num_envs = 8: must be a multiple of"),
        ({"ray_collectors": 2, "live": True}, "take live=false and device=cpu"),
        ({"ray_collectors": -1}, "ray_collectors = -1: must be at least 0"),
    ],
)
def test_flows_that_cannot_be_shared_are_refused(
    toy_config: MakeConfig, wrong: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        toy_config(**wrong)


def test_without_ray_it_says_what_to_install(
    toy_config: MakeConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settings, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install 'fishrl\[cluster\]'"):
        set_up(toy_config(ray_collectors=2), make_env=make_toy_env)
    assert not any(tmp_path.iterdir())


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    ray = pytest.importorskip("ray", reason="pip install 'fishrl[cluster]'")
    from fishrl.training.cluster import join_cluster

    assert join_cluster(2)
    assert not join_cluster(2)
    yield
    ray.shutdown()


def training_of(config: TrainConfig) -> Training:
    return set_up(config, make_env=make_toy_env)


@pytest.mark.cluster
@pytest.mark.usefixtures("cluster")
def test_a_run_on_a_cluster_goes_on_exactly_after_a_stop(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    shared: dict[str, Any] = {
        "ray_collectors": 2,
        "algorithm": {"_target_": "fishrl.training.algorithms.DQN", "epsilon_frames": 100},
        "task": {"divergence_rate": 0.05, "banned_action": 2},
    }
    whole = training_of(toy_config(name="whole", **shared))
    finish(whole)
    counters, buffer = whole.counters, whole.learner.buffer
    assert counters.diverged > 0
    assert len(buffer) == counters.frames - counters.diverged == 240 - counters.diverged
    assert set(buffer[:]["action"].tolist()) == {0, 1}
    finish(training_of(toy_config(name="parts", total_frames=120, **shared)))
    config = toy_config(resume=str(tmp_path / "parts"), **shared)
    finish(training_of(config))
    assert rows_of(tmp_path / "parts") == rows_of(tmp_path / "whole")
    assert RunFolder(tmp_path / "whole").summary.is_file()


@pytest.mark.cluster
@pytest.mark.usefixtures("cluster")
def test_collectors_act_with_the_newest_weights_and_know_their_episodes_apart(
    toy_config: MakeConfig,
) -> None:
    training = training_of(toy_config(ray_collectors=2, warmup_frames=0))
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
def test_a_lost_machine_ends_the_run_and_nothing_hangs(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    import ray

    training = training_of(toy_config(name="run", ray_collectors=2))
    log = training.metrics_logger.log

    def log_and_lose(metrics: Mapping[str, float]) -> None:
        log(metrics)
        ray.kill(training.collector._flows.remote_collectors[0])

    training.metrics_logger.log = log_and_lose
    with pytest.raises(ray.exceptions.RayActorError):
        finish(training)
    assert read_run(tmp_path / "run").status == "failed"


@pytest.mark.cluster
def test_a_cluster_that_is_too_small_is_refused(
    toy_config: MakeConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = pytest.importorskip("ray", reason="pip install 'fishrl[cluster]'")
    monkeypatch.setattr(ray, "is_initialized", lambda: True)
    monkeypatch.setattr(ray, "cluster_resources", lambda: {"CPU": 1.0})
    with pytest.raises(ConfigError, match="the cluster has 1 CPUs, and each takes one"):
        set_up(toy_config(ray_collectors=2), make_env=make_toy_env)
