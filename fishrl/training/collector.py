"""The collector of a run: in this process, or in processes of a cluster."""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict
from torchrl.checkpoint import GlobalRNGState
from torchrl.collectors import Collector
from torchrl.data import Composite
from torchrl.envs import ActionMask, EnvBase, Transform, TransformedEnv

from fishrl.training.learner import Learner
from fishrl.training.opening import Opened


class ResumableCollector(Collector):
    """TorchRL's collector, whose state also holds the flows and the state they are about to act in.

    The parent saves the buffers of the transforms and its counters, but neither the base env nor
    the TensorDict that it carries from step to step: after loading, new episodes would begin on the
    frame stacks of the old ones.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        # the parent looks for private entries in each batch, which takes as long as a transform
        keys = self.env.specs.keys(True)
        names = [name for key in keys for name in (key if isinstance(key, tuple) else (key,))]
        self._exclude_private_keys = any(name.startswith("_") for name in names)

    def state_dict(self) -> OrderedDict[str, Any]:
        """Return everything the next batch depends on, apart from the global generators."""
        state: OrderedDict[str, Any] = super().state_dict()
        state["base_env"] = self.env.base_env.state_dict()
        state["carrier"] = self._carrier.clone().to_dict()
        return state

    def load_state_dict(self, state_dict: Any, **kwargs: Any) -> None:
        """Restore a state of ``state_dict`` into a collector of an equal env."""
        state = dict(state_dict)
        base_env, carrier = state.pop("base_env"), state.pop("carrier")
        super().load_state_dict(OrderedDict(state), **kwargs)
        if self.track_traj_ids:  # the parent counted on fresh trajectories
            self._traj_pool.load_state_dict(state["traj_pool"])
        self.env.base_env.load_state_dict(base_env)
        self._carrier: TensorDict = TensorDict.from_dict(
            carrier, batch_size=self.env.batch_size, device=self._carrier.device
        ).clone()
        for name, spec in self.env.observation_spec.items():
            if isinstance(spec, Composite):  # a group of fish
                self._carrier[name].batch_size = spec.shape
        for transform in self.env.transform:
            if isinstance(transform, ActionMask):  # it keeps the mask inside the action spec
                transform._call(self._carrier)

    @contextmanager
    def lend_env(self) -> Iterator[EnvBase]:
        """Lend the env, and restore everything afterwards."""
        state = self.state_dict()
        # the solver's are copies already, and the largest
        flows = state["base_env"].get("_extra_state", {}).get("solver", {})
        state = deepcopy(state, {id(copy): copy for copy in flows.values()})
        try:
            yield self.env
        finally:
            self.load_state_dict(state)


class RemoteCollector(ResumableCollector):
    """The collector of one process of a cluster; its state includes the random generators."""

    def state_dict(self) -> OrderedDict[str, Any]:
        """Return everything its next batch depends on."""
        of_gpus = torch.cuda.get_rng_state_all()
        return OrderedDict(super().state_dict(), rng=torch.get_rng_state(), gpu_rng=of_gpus)

    def load_state_dict(self, state_dict: Any, **kwargs: Any) -> None:
        """Restore a state of ``state_dict``."""
        state = dict(state_dict)
        torch.set_rng_state(state.pop("rng").cpu())  # a checkpoint is read onto the run's device
        of_gpus = state.pop("gpu_rng", [])[: torch.cuda.device_count()]
        torch.cuda.set_rng_state_all([one.cpu() for one in of_gpus])
        super().load_state_dict(state, **kwargs)


def make_collector(opened: Opened, learner: Learner, *, seed: int) -> Any:
    """Make the collector of a run, in this process or in processes of a cluster."""
    explorer, plan = learner.explorer, opened.plan
    make_flows = partial(_extend, opened.make_flows, learner.transforms)
    env = make_flows(flows=plan.flows, seed=seed)
    actor_device = plan.learner_device and next(learner.actor.parameters()).device
    before = deepcopy(explorer.state_dict())
    local = ResumableCollector(
        env,
        explorer,
        frames_per_batch=plan.flows.num_envs,
        total_frames=-1,
        init_random_frames=plan.warmup_frames,
        policy_device=actor_device,
        env_device=env.device,  # given, TorchRL waits for actions that come from a GPU
        storing_device=plan.policy_device,  # trajectory ids too, which DRQN's sampler reads
    )
    explorer.load_state_dict(before)  # TorchRL has asked for a decision, which epsilon counts
    if not plan.ray_collectors:
        return local
    from fishrl.training.cluster import ClusterCollector

    return ClusterCollector(
        RemoteCollector,
        local=local,
        make_env=make_flows,
        explorer=explorer,
        settings=plan,
        seed=seed,
    )


def _extend(
    make_flows: Callable[..., TransformedEnv], transforms: Iterable[Transform], **given: Any
) -> TransformedEnv:
    """Make flows with copies of further transforms."""
    env = make_flows(**given)
    for transform in transforms:
        env.append_transform(transform.clone())
    return env


class RNGState(GlobalRNGState):
    """The state of all random number generators.

    Generators of GPUs that this machine lacks are left out: a run continues with other GPUs or on a
    CPU, though not bit for bit.
    """

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restore the generators of this machine."""
        gpus = state_dict.get("torch_cuda", [])[: torch.cuda.device_count()]
        others = {name: value for name, value in state_dict.items() if name != "torch_cuda"}
        super().load_state_dict(others | ({"torch_cuda": gpus} if gpus else {}))
