"""Specs of observations, actions and rewards, derived from a task."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded

from fishrl.envs.agents import AGENTS, TERM
from fishrl.envs.sense import count_numbers
from fishrl.envs.task import AbstractTask


def make_specs(task: AbstractTask, now: TensorDictBase) -> tuple[Composite, Composite, Composite]:
    """Return the specs of one row's observation, action and reward, given a measurement ``[B]``.

    An action is an index, or numbers in [-1, 1].
    """
    reported = {
        name: Binary(shape[-1], shape=shape, dtype=torch.bool)
        if value.dtype == torch.bool
        else Unbounded(shape, dtype=value.dtype)
        for name, value in task.report(now).items()
        for shape in [tuple(value.shape[1:]) or (1,)]
    }
    own: dict[str, TensorSpec] = {"observation": Unbounded((task.n_obs,))}
    if senses := task.critic_senses:
        own["critic_observation"] = Unbounded((count_numbers(senses),))
    own |= {TERM + name: Unbounded((1,)) for name in task.reward(now, now)}
    action: TensorSpec = Bounded(-1.0, 1.0, shape=(task.num_actions,))
    if task.action_bounds is None:
        own["action_mask"] = Binary(task.num_actions, dtype=torch.bool)
        action = Categorical(task.num_actions)
    observation = Composite(
        diverged=Binary(1, dtype=torch.bool),
        start_index=Unbounded((), dtype=torch.int64),
        **reported,
        **_group(task, own),
    )
    reward = Composite(_group(task, {"reward": Unbounded((1,))}))
    return observation, Composite(_group(task, {"action": action})), reward


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
