"""Specs of observations, actions and rewards, derived from a task."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded

from fishrl.envs.agents import AGENTS
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
    own: dict[str, TensorSpec] = {"observation": Unbounded((task.n_obs,))}
    if task.action_bounds is None:
        own["action_mask"] = Binary(task.num_actions, dtype=torch.bool)
    return Composite(
        diverged=Binary(1, dtype=torch.bool),
        start_index=Unbounded((), dtype=torch.int64),
        **reported,
        **_group(task, own),
    )


def make_action_spec(task: AbstractTask) -> Composite:
    """Return the spec of one row's actions: an index, or numbers in [-1, 1]."""
    if task.action_bounds is None:
        return Composite(_group(task, {"action": Categorical(task.num_actions)}))
    numbers = Bounded(-1.0, 1.0, shape=(task.num_actions,))
    return Composite(_group(task, {"action": numbers}))


def make_reward_spec(task: AbstractTask) -> Composite:
    """Return the spec of one row's rewards."""
    return Composite(_group(task, {"reward": Unbounded((1,))}))


def _group(task: AbstractTask, own: dict[str, TensorSpec]) -> dict[str, TensorSpec]:
    """Return specs of each fish where its entries are, see ``fishrl.envs.agents``."""
    if task.num_fish == 1:
        return own
    shape = (task.num_fish,)
    return {
        AGENTS: Composite(
            {name: spec.expand(*shape, *spec.shape) for name, spec in own.items()}, shape=shape
        )
    }
