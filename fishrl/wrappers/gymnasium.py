"""Flows for Gymnasium: a vector environment, a single one, and ids for ``gymnasium.make``.

Needs the extra ``gymnasium``. Importing this module registers the ids::

    import gymnasium
    import fishrl.wrappers.gymnasium

    envs = gymnasium.make_vec("fishrl/Predation-v0", num_envs=8, body_length=50)
    env = gymnasium.make("fishrl/gait_bend", render_mode="rgb_array")
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from inspect import signature
from typing import Any

from fishrl.envs import (
    AbstractTask,
    Flows,
    Follower,
    KarmanGait,
    Predation,
    make_env,
    make_task,
)
from fishrl.presets import list_tasks
from fishrl.settings import checked
from fishrl.wrappers.vector import FlowVectorEnv  # first: it names the extra if it is missing

from gymnasium import register  # isort: skip

from fishrl.wrappers.single import FlowSingleEnv

__all__ = ["TASKS", "FlowSingleEnv", "FlowVectorEnv", "make_single", "make_vector"]

_VERSIONED = {name.rpartition("-v")[0] for name in list_tasks()}
#: Classes of tasks and all presets by id; add your own by ``gymnasium.register`` as below. Where
#: there is ``predation-v1``, Gymnasium allows no ``predation``.
TASKS: dict[str, Callable[..., AbstractTask]] = {
    **{f"fishrl/{task.__name__}-v0": task for task in (Predation, KarmanGait, Follower)},
    **{
        f"fishrl/{name}": partial(make_task, name)
        for name in list_tasks()
        if name not in _VERSIONED
    },
}


@checked
def make_vector(
    task: Callable[..., AbstractTask] | str, num_envs: int, **settings: Any
) -> FlowVectorEnv:
    """Return a vector environment of flows.

    Args:
        task: class of the task, a function that makes it, or its id in ``TASKS``.
        num_envs: number of flows, regardless of ``flows.num_envs``.
        settings: arguments of ``make_env`` and ``FlowVectorEnv``; all others go to the task.
            ``reset(seed=...)`` repeats episodes.

    Raises:
        ValueError: for unknown settings.
    """
    making, wrapping = (
        {name: settings.pop(name) for name in signature(takes).parameters if name in settings}
        for takes in (make_env, FlowVectorEnv)
    )
    flows = replace(making.pop("flows", Flows()), num_envs=num_envs)
    make = TASKS[task] if isinstance(task, str) else task
    env = make_env(task=make(**settings), flows=flows, **making)
    return FlowVectorEnv(env, **wrapping)


@checked
def make_single(task: Callable[..., AbstractTask] | str, **settings: Any) -> FlowSingleEnv:
    """Return an environment of one flow; arguments are those of ``make_vector``."""
    if "num_envs" in settings or "autoreset_mode" in settings:
        raise ValueError(
            "num_envs, autoreset_mode: gymnasium.make makes one flow; use gymnasium.make_vec"
        )
    return FlowSingleEnv(make_vector(task, 1, autoreset_mode="Disabled", **settings))


for name in TASKS:
    register(
        name,
        entry_point=f"{__name__}:make_single",
        vector_entry_point=f"{__name__}:make_vector",
        kwargs={"task": name},  # a text, so that a spec can be written as JSON
    )
