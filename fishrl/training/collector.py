"""The collector of a run: in this process, or in those of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from torch import nn
from torchrl.envs import EnvBase, Transform

from fishrl.envs import AbstractTask
from fishrl.training.learner import Learner
from fishrl.training.resumable import ResumableCollector
from fishrl.training.settings import LearningSettings

MakeEnv = Callable[..., EnvBase]


def make_collector(
    task: AbstractTask,
    learner: Learner,
    settings: LearningSettings,
    *,
    make_env: MakeEnv,
    recognition: nn.Module | str | None,
    device: str,
    compile: bool,
    seed: int,
) -> Any:
    """Make the collector of a run, in this process or in those of a cluster.

    Args:
        task: the task.
        learner: its explorer acts.
        settings: number of flows, of processes, and of warm-up frames.
        make_env: makes the env of a task, such as ``fishrl.envs.make_env``.
        recognition: source of flow labels, see there.
        device: of the flows.
        compile: compile the flow step.
        seed: of the flows.
    """
    given = {} if recognition is None else {"recognition": recognition}
    make = partial(
        _make_equipped,
        make_env,
        learner.transforms,
        task=task,
        device=device,
        compile=compile,
        **given,
    )
    # observers may read the flows at every check for termination
    env = make(num_envs=settings.num_envs, seed=seed, frames_per_action=task.checks_per_action)
    if not settings.ray_collectors:
        return ResumableCollector(
            env,
            learner.explorer,
            frames_per_batch=settings.num_envs,
            total_frames=-1,
            init_random_frames=settings.warmup_frames,
            storing_device=device,  # trajectory ids too, which the sampler of DRQN reads
        )
    from fishrl.training.cluster import ClusterCollector

    return ClusterCollector(
        env=env,
        make_env=make,
        explorer=learner.explorer,
        num_collectors=settings.ray_collectors,
        num_envs=settings.num_envs,
        warmup_frames=settings.warmup_frames,
        seed=seed,
    )


def _make_equipped(make_env: MakeEnv, transforms: Sequence[Transform], **arguments: Any) -> EnvBase:
    """Make an env with its own copies of transforms."""
    env = make_env(**arguments)
    for transform in transforms:
        env.append_transform(transform.clone())
    return env
