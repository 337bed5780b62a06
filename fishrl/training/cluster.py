"""Flows on several machines: TorchRL's Ray collector in place of the local one.

All collectors take one decision in each of their flows with the newest weights, then the loop
learns: the same order as in one process. Evaluations and recordings use flows of this process and
leave the training flows alone.
"""

import logging
import os
import sys
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.collectors.distributed import RayCollector
from torchrl.envs import EnvBase
from torchrl.modules import EGreedyModule

from fishrl.envs import Flows
from fishrl.envs.agents import split_fish
from fishrl.training.settings import LearningSettings

logger = logging.getLogger(__name__)

#: Between the seeds of two collectors, so that no other run's lie between them.
SEED_STRIDE = 1_000_000
#: Between looks at the size of the cluster, while collectors start.
CHECK_SECONDS = 5.0


class ClusterCollector:
    """Collects in processes of a Ray cluster; evaluations borrow the env of a local collector.

    It joins the cluster that ``RAY_ADDRESS`` names, or starts one on this machine.

    Args:
        collector_class: class of the collector in each process.
        local: collector of this process, which collects nothing.
        make_env: makes the env of a collector from ``flows`` and ``seed``; picklable.
        explorer: the policy that collects.
        settings: numbers of processes, of flows and of warm-up frames of all of them together.
        seed: seed of the first collector.

    Raises:
        ValueError: if the cluster has fewer CPUs, or GPUs, than there are collectors.
    """

    def __init__(
        self,
        collector_class: type[Collector],
        *,
        local: Any,
        make_env: Callable[..., EnvBase],
        explorer: TensorDictModuleBase,
        settings: LearningSettings,
        seed: int,
    ) -> None:
        self._local, self.env, self.lend_env = local, local.env, local.lend_env
        flows, num_collectors = settings.flows, settings.ray_collectors
        num_envs, self._device = flows.num_envs, flows.device
        self._explorer, self._frames = explorer, 0
        self._warmup_frames = -(-settings.warmup_frames // num_envs) * num_envs  # whole batches
        num_gpus = int(flows.device == "cuda")
        self._has_joined = join_cluster(num_collectors, num_gpus=num_gpus * num_collectors)
        share = replace(flows, num_envs=num_envs // num_collectors)
        make = partial(_make_seeded, make_env, flows=share)
        with noticing_losses():
            self._flows = RayCollector(
                [partial(make, seed=seed + SEED_STRIDE * i) for i in range(num_collectors)],
                explorer,
                collector_class=collector_class,
                frames_per_batch=num_envs,
                total_frames=sys.maxsize,
                init_random_frames=self._warmup_frames,
                sync=True,
                weight_sync_schemes={},  # _send_weights does it
                storing_device="cpu",  # between machines
                remote_configs={
                    "num_cpus": 1,
                    "num_gpus": num_gpus,
                    "scheduling_strategy": "SPREAD",
                },
            )
            self._await_flows(num_gpus=num_gpus * num_collectors)

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Collect batches ``[num_collectors, flows of each, 1]``, one decision of every flow."""
        batches = iter(self._flows)
        while True:
            with noticing_losses(), warnings.catch_warnings():
                warnings.filterwarnings("ignore", "RayCollector iteration started before weight")
                self._send_weights()
                batch = next(batches).to(self._device)
            if self._frames >= self._warmup_frames:
                self._count_exploration(split_fish(batch).numel())
            self._frames += batch.numel()
            ids, num = batch["collector", "traj_ids"], batch.shape[0]
            owner = torch.arange(num, device=ids.device).view(num, *[1] * (ids.ndim - 1))
            batch["collector", "traj_ids"] = ids * num + owner  # no two episodes share one
            yield batch

    def _await_flows(self, *, num_gpus: int) -> None:
        """Wait until all flows are made; meanwhile a machine may be found to be lost."""
        import ray

        remote = self._flows.remote_collectors
        answers = waiting = [
            collector.get_distant_attr.remote("frames_per_batch") for collector in remote
        ]
        while waiting:
            check_size(len(remote), num_gpus=num_gpus)
            _, waiting = ray.wait(waiting, num_returns=len(waiting), timeout=CHECK_SECONDS)
        ray.get(answers)

    def _send_weights(self) -> None:
        """Send the current weights to all collectors, through Ray.

        TorchRL's own scheme opens further connections, which hang when a machine is lost.
        """
        import ray

        weights = ray.put(TensorDict.from_module(self._explorer).data.cpu())
        remote = self._flows.remote_collectors
        ray.get([collector.update_policy_weights_.remote(weights) for collector in remote])

    def _count_exploration(self, num_decisions: int) -> None:
        """Advance the exploration schedule here too, because it is sent with the weights."""
        for module in self._explorer.modules():
            if isinstance(module, EGreedyModule):
                module.step(num_decisions)

    def state_dict(self) -> dict[str, Any]:
        """Return everything the next batch depends on, from all machines."""
        state = {"frames": self._frames, "explorer": self._explorer.state_dict()}
        with noticing_losses():
            return {**state, "collectors": self._flows.state_dict()}

    def load_state_dict(self, state_dict: Any) -> None:
        """Restore a state of ``state_dict`` into as many collectors."""
        self._frames = state_dict["frames"]
        self._explorer.load_state_dict(state_dict["explorer"])
        with noticing_losses():
            self._flows.load_state_dict([OrderedDict(state) for state in state_dict["collectors"]])

    def shutdown(self) -> None:
        """End all flows, and the cluster if it was started here."""
        self._local.shutdown()
        self._flows.shutdown(shutdown_ray=self._has_joined)


@contextmanager
def noticing_losses() -> Iterator[None]:
    """Raise ChildProcessError where a collector, machine or object is found to be lost.

    Any error of Ray's own counts, as there is one for each thing that can be lost. A training
    continues from its checkpoint, and ends if it fails again. What a collector raises is passed on.
    """
    from ray.exceptions import RayError, RayTaskError

    try:
        yield
    except RayError as error:
        if isinstance(error, RayTaskError) and not isinstance(error.cause, RayError):
            raise
        what = type(error).__name__
        raise ChildProcessError(f"a collector of the Ray cluster is lost ({what})") from error


def join_cluster(num_collectors: int, *, num_gpus: int = 0) -> bool:
    """Connect to the cluster that ``RAY_ADDRESS`` names, or start a local one of sufficient size.

    Returns:
        Whether this process was not connected before.

    Raises:
        ValueError: see ``check_size``.
    """
    import ray

    is_new = not ray.is_initialized()
    if is_new:
        local = {"address": "local", "num_cpus": num_collectors, "include_dashboard": False}
        given: dict[str, Any] = {} if "RAY_ADDRESS" in os.environ else local
        is_silent = "RAY_USAGE_STATS_ENABLED" not in os.environ
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # report nothing to anybody
        try:
            ray.init(log_to_driver=False, logging_level=logging.WARNING, **given)
        finally:
            if is_silent:
                del os.environ["RAY_USAGE_STATS_ENABLED"]
    check_size(num_collectors, num_gpus=num_gpus)
    num_cpus = ray.cluster_resources()["CPU"]
    logger.info("%d collectors on a cluster of %d CPUs", num_collectors, num_cpus)
    return is_new


def check_size(num_collectors: int, *, num_gpus: int) -> None:
    """Raise ValueError if the cluster has fewer CPUs or GPUs than that many collectors take."""
    import ray

    resources = ray.cluster_resources()
    for kind, needed in {"CPU": num_collectors, "GPU": num_gpus}.items():
        there = int(resources.get(kind, 0))
        if there < needed:
            raise ValueError(
                f"ray_collectors={num_collectors}: the cluster has {there} {kind}s, and each takes "
                "one; take fewer, or add machines with `ray start --address=...`"
            )


def _make_seeded(make_env: Callable[..., EnvBase], *, flows: Flows, seed: int) -> EnvBase:
    """Make the env of a collector, in its process, and seed its policy."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    return make_env(flows=flows, seed=seed)
