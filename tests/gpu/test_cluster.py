"""Collectors of a Ray cluster that have a GPU each; the pretended ones share the host's memory."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import ray

from fishrl.envs import Flows, Predation
from fishrl.training import Plan, Training, complete, open_run
from tests.docs.test_tutorials import BRIEF
from tests.envs.test_real_flow import TINY

pytestmark = [pytest.mark.gpu, pytest.mark.cluster, pytest.mark.xdist_group("cluster")]


@pytest.fixture(autouse=True, scope="module")
def cluster() -> Iterator[None]:
    pretended = {"PRETEND_CUDA": os.environ.get("PRETEND_CUDA", "")}
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PRETEND_CUDA", raising=False)  # Ray's own processes start without torch
        quiet = {"include_dashboard": False, "log_to_driver": False}
        ray.init(num_cpus=3, num_gpus=2, runtime_env={"env_vars": pretended}, **quiet)
    yield
    ray.shutdown()


def make_plan(folder: Path, *, name: str, num_frames: int, ray_collectors: int = 2) -> Plan:
    return Plan(
        task=Predation(**TINY | BRIEF | {"time_limit": 2}),
        flows=Flows(num_envs=ray_collectors, compile=False, device="cuda"),
        ray_collectors=ray_collectors, warmup_frames=0,
        updates_per_frame=1.0, batch_size=2, hidden=(8,),
        total_frames=num_frames, log_frames=1, folder=str(folder),
        name=name, eval_episodes=1, final_episodes=1, baselines=(),
    )  # fmt: skip


def test_each_collector_has_a_gpu_of_its_own(tmp_path: Path) -> None:
    training = Training(open_run(make_plan(tmp_path, name="run", num_frames=4)))
    assert ray.available_resources().get("GPU", 0.0) == 0.0
    complete(training)
    assert training.learner.buffer[:]["observation_stack"].device.type == "cuda"


def test_a_cluster_with_too_few_gpus_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="the cluster has 2 GPUs, and each takes one"):
        Training(open_run(make_plan(tmp_path, name="run", num_frames=2, ray_collectors=3)))
