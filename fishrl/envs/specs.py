"""Specs of observations and actions, derived from a task."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded

from fishrl.envs.task import AbstractTask


def make_observation_spec(task: AbstractTask, now: TensorDictBase) -> Composite:
    """Return the spec of what an environment writes for one row, given a measurement ``[B]``."""
    reported = {
        name: Binary(shape[-1], shape=shape, dtype=torch.bool)
        if value.dtype == torch.bool
        else Unbounded(shape, dtype=value.dtype)
        for name, value in task.report(now).items()
        for shape in [tuple(value.shape[1:]) or (1,)]
    }
    if task.action_bounds is None:
        reported["action_mask"] = Binary(task.num_actions, dtype=torch.bool)
    return Composite(
        observation=Unbounded((task.n_obs,)),
        diverged=Binary(1, dtype=torch.bool),
        start_index=Unbounded((), dtype=torch.int64),
        **reported,
    )


def make_action_spec(task: AbstractTask) -> TensorSpec:
    """Return the spec of one row's action: an index, or numbers in [-1, 1]."""
    if task.action_bounds is None:
        return Categorical(task.num_actions)
    return Bounded(-1.0, 1.0, shape=(task.num_actions,))
