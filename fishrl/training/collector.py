"""What collects: a collector that goes on exactly where it was stopped, here or on a cluster."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import ActionMask, EnvBase, Transform

from experiments.settings import TrainConfig
from fishrl.training.evaluation import copy_state
from fishrl.training.learner import Learner
from fishrl.training.recognition import Recognition

MakeEnv = Callable[..., EnvBase]


class ResumableCollector(Collector):
    """TorchRL's collector, whose state also holds the flows and the state they are about to act in.

    The parent saves the buffers of the transforms and its counters, but neither the base env nor
    the TensorDict that it carries from step to step: after loading, episodes would start anew on
    the frame stacks of the old ones.
    """

    def state_dict(self) -> OrderedDict:
        """Return everything the next batch depends on, apart from the global generators."""
        state = super().state_dict()
        state["base_env"] = self.env.base_env.state_dict()
        state["carrier"] = self._carrier.clone().to_dict()
        return state

    def load_state_dict(self, state_dict: Any, **kwargs: Any) -> None:
        """Restore what ``state_dict`` returned into a collector of an equal env."""
        state = dict(state_dict)
        base_env, carrier = state.pop("base_env"), state.pop("carrier")
        super().load_state_dict(OrderedDict(state), **kwargs)
        if self.track_traj_ids:  # the parent counted on fresh trajectories
            self._traj_pool.load_state_dict(state["traj_pool"])
        self.env.base_env.load_state_dict(base_env)
        self._carrier: TensorDict = TensorDict.from_dict(
            carrier, batch_size=self.env.batch_size, device=self.env.device
        )
        for transform in self.env.transform:
            if isinstance(transform, ActionMask):  # it keeps the mask inside the action spec
                transform._call(self._carrier)

    @contextmanager
    def lend_env(self) -> Iterator[EnvBase]:
        """Lend the env, and leave everything as it was before."""
        state = copy_state(self.state_dict())
        try:
            yield self.env
        finally:
            self.load_state_dict(state)


def make_collector(
    config: TrainConfig,
    recognition: Recognition,
    make_env: MakeEnv,
    learner: Learner,
    *,
    seed: int,
) -> Any:
    """Make what collects for a run, in this process or in those of a cluster.

    Args:
        config: settings of the run.
        recognition: the task, and who tells the fish its flow.
        make_env: makes the env of a task.
        learner: whose explorer acts.
        seed: of the flows.
    """
    make = partial(
        _make_equipped,
        make_env,
        recognition,
        learner.transforms,
        device=config.device,
        compile=config.compile,
    )
    # the looks within an action are for the recording at the end
    looks = recognition.task.checks_per_action
    env = make(num_envs=config.num_envs, seed=seed, frames_per_action=looks)
    if not config.ray_collectors:
        return ResumableCollector(
            env,
            learner.explorer,
            frames_per_batch=config.num_envs,
            total_frames=-1,
            init_random_frames=config.warmup_frames,
        )
    from fishrl.training.cluster import ClusterCollector

    return ClusterCollector(
        env=env,
        make_env=make,
        explorer=learner.explorer,
        num_collectors=config.ray_collectors,
        num_envs=config.num_envs,
        warmup_frames=config.warmup_frames,
        seed=seed,
    )


def _make_equipped(
    make_env: MakeEnv, recognition: Recognition, transforms: Sequence[Transform], **arguments: Any
) -> EnvBase:
    """Make an env whose transforms are its own."""
    env = recognition.equip(make_env)(task=recognition.task, **arguments)
    for transform in transforms:
        env.append_transform(transform.clone())
    return env
