"""Flows that advance in the processes of a Ray cluster, whose machines this one plays."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch

from fishrl.envs import Flows, PredationPair, make_env
from fishrl.training import complete, open_run
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.cluster import ClusterCollector, noticing_losses
from fishrl.training.collector import ResumableCollector
from fishrl.training.loop import Training
from tests.envs.conftest import SMALL, move_kinematically
from tests.training.conftest import QUICK, Toy, make_toy_plan, read_rows


def test_invalid_number_of_collectors_is_refused(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fishrl.training.opening.find_spec", lambda name: None)
    for wrong, said in (
        ({"ray_collectors": 3}, "flows.num_envs = 8: must be a multiple of"),
        ({"ray_collectors": -1}, "ray_collectors = -1: must be greater than or equal to 0"),
        ({"ray_collectors": 2}, "needs Ray: pip install 'ray"),
    ):
        with pytest.raises(ValueError, match=said):
            toy.begin(**wrong)
    assert not any(toy.folder.iterdir())


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two machines with a CPU each, played by this one."""
    import ray
    from ray.cluster_utils import Cluster

    from fishrl.training.cluster import join_cluster

    alone = {"num_cpus": 1, "include_log_monitor": False}
    head = {**alone, "include_dashboard": False, "no_monitor": True}
    machines = Cluster(initialize_head=True, head_node_args=head)
    machines.add_node(**alone)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_ADDRESS", machines.address)
        assert join_cluster(2)
        assert not join_cluster(2)
        yield machines
    ray.shutdown()
    machines.shutdown()


#: Whose evaluations draw random numbers, too.
SHARED: dict[str, Any] = {
    "ray_collectors": 2,
    "algorithm": DQN(epsilon_frames=100),
    "task": {"divergence_rate": 0.05, "banned_action": 2},
    "baselines": (),
}


@pytest.mark.cluster
def test_run_continues_exactly_after_lost_machine(
    toy: Toy, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The decisions between checkpoint and loss are made twice."""
    send, batches = ClusterCollector._send_weights, itertools.count()

    def send_and_lose(self: ClusterCollector) -> None:
        if next(batches) == 19:
            cluster.remove_node(cluster.list_all_nodes()[-1], allow_graceful=False)
            cluster.wait_for_nodes()
        send(self)

    monkeypatch.setattr(ClusterCollector, "_send_weights", send_and_lose)
    training = toy.begin(name="run", log_frames=16, **SHARED)
    with pytest.raises(ValueError, match="the cluster has 1 CPUs, and each takes one"):
        complete(training)
    assert next(batches) == 20
    assert training.folder.failure.is_file()
    before = toy.rows("run")
    cluster.add_node(num_cpus=1)
    again = toy.reopen("run")
    complete(again)
    assert not training.folder.failure.exists()
    assert next(batches) == 20 + 1 + 20  # from the checkpoint at frame 80
    after = toy.rows("run")
    assert [int(row["frames"]) for row in before[-5:]] == [96, 112, 120, 128, 144]
    assert after[: len(before)] == before
    counters, buffer = again.counters, again.learner.buffer
    assert counters.diverged > 0
    assert len(buffer) == counters.frames - counters.diverged == 240 - counters.diverged
    assert set(buffer[:]["action"].tolist()) == {0, 1}


def make_gliding_env(**arguments: Any) -> Any:
    """Make an env whose fish move without a flow, in whichever process."""
    with pytest.MonkeyPatch.context() as patch:
        move_kinematically(patch)
        return make_env(**arguments)


@pytest.mark.cluster
@pytest.mark.usefixtures("cluster")
def test_collectors_have_new_weights_and_frames(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two fish each: trajectories are distinct, and epsilon decays by flows, not by fish."""
    few = {"ray_collectors": 2, "flows": Flows(num_envs=4, compile=False), "warmup_frames": 4}
    plan = make_toy_plan(toy.folder, algorithm=DQN(epsilon_end=0.0, epsilon_frames=16), **few)
    pair = PredationPair(**SMALL, control_interval_T=0.25, checks_per_action=6)
    monkeypatch.setattr("fishrl.training.opening.make_env", make_gliding_env)
    training = Training(open_run(replace(plan, task=pair)))
    batches = iter(training.collector)
    first = next(batches)
    assert first.batch_size == torch.Size([2, 2, 1])
    assert not torch.equal(first[0]["agents", "observation"], first[1]["agents", "observation"])
    assert len(first["collector", "traj_ids"].unique()) == 4
    with torch.no_grad():
        for weights in training.learner.explorer.parameters():
            weights.fill_(0.0)
    assert next(batches)["agents", "action_value"].eq(0.0).all()
    next(batches)
    chance: Any = training.learner.explorer.policy[-1]  # type: ignore[index]
    assert float(chance.eps) == pytest.approx(1.0 - (3 * 4 - 4) / 16)
    training.close()


def list_losses() -> list[type[Exception]]:
    """List Ray's errors, but for those of a collector's own code."""
    from ray import exceptions

    kinds = [kind for kind in vars(exceptions).values() if isinstance(kind, type)]
    return [
        kind
        for kind in kinds
        if issubclass(kind, exceptions.RayError) and not issubclass(kind, exceptions.RayTaskError)
    ]


def make_error(kind: type[Exception]) -> Exception:
    error = kind.__new__(kind)
    error.args = ("lost",)
    return error


@pytest.mark.cluster
def test_every_loss_that_ray_knows_is_noticed_and_errors_of_collectors_are_passed_on() -> None:
    from ray.exceptions import NodeDiedError, RayTaskError

    losses = list_losses()
    assert len(losses) > 20
    for kind in losses:
        with pytest.raises(ChildProcessError, match=kind.__name__), noticing_losses():
            raise make_error(kind)
    for cause, expected in (
        (ValueError("wrong"), ValueError),
        (NodeDiedError("gone"), ChildProcessError),
    ):
        error = RayTaskError("collect", "", cause).as_instanceof_cause()
        with pytest.raises(expected), noticing_losses():
            raise error


def test_training_continues_from_its_checkpoint_when_a_machine_is_lost_while_saving(
    toy: Toy, monkeypatch: pytest.MonkeyPatch, whole: Training
) -> None:
    """Without Ray: the local collector raises what losses are turned into."""
    calls, save = itertools.count(1), ResumableCollector.state_dict

    def lose(collector: ResumableCollector) -> Any:
        if next(calls) == 3:
            raise ChildProcessError("a collector of the Ray cluster is lost")
        return save(collector)

    training = toy.begin(name="run", **QUICK)
    monkeypatch.setattr(ResumableCollector, "state_dict", lose)
    complete(training)
    assert toy.rows("run") == read_rows(whole.folder.path)
