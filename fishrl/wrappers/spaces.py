"""Gymnasium's spaces of an environment."""

import numpy as np
from gymnasium.spaces import Box, Discrete
from torchrl.envs import TransformedEnv

from fishrl.envs.agents import name_entry


def make_spaces(env: TransformedEnv) -> tuple[Box, Box | Discrete]:
    """Return the spaces of one fish's stacked observations and of its actions."""
    task = env.base_env.task
    size = env.full_observation_spec[name_entry(task, "observation_stack")].shape[-1]
    seen = Box(-np.inf, np.inf, (size,), np.float32)
    if task.action_bounds is None:
        return seen, Discrete(task.num_actions)
    return seen, Box(-1.0, 1.0, (task.num_actions,), np.float32)
