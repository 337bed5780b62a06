"""Flows for Gymnasium: a vector environment, a single one, and ids for ``gymnasium.make``.

Needs the extra ``gymnasium``. Importing this module registers the ids::

    import gymnasium
    import fishrl.wrappers.gymnasium

    envs = gymnasium.make_vec("fishrl/Predation-v0", num_envs=8, body_length=50)
    env = gymnasium.make("fishrl/KarmanGait-v0", recognition="oracle", render_mode="rgb_array")
"""

from dataclasses import replace
from inspect import signature
from secrets import randbits
from typing import Any

from fishrl.envs import AbstractTask, Flows, Follower, KarmanGait, Predation, make_env
from fishrl.wrappers.vector import FlowVectorEnv  # first: it names the extra if it is missing

from gymnasium import register  # isort: skip

from fishrl.wrappers.single import FlowSingleEnv

__all__ = ["TASKS", "FlowSingleEnv", "FlowVectorEnv", "make_single", "make_vector"]

#: Tasks with one fish by id; add your own by ``gymnasium.register`` as below.
TASKS: dict[str, type[AbstractTask]] = {
    f"fishrl/{task.__name__}-v0": task for task in (Predation, KarmanGait, Follower)
}


def make_vector(task: type[AbstractTask], num_envs: int, **settings: Any) -> FlowVectorEnv:
    """Return a vector environment of flows.

    Args:
        task: class of the task.
        num_envs: number of flows, regardless of ``flows.num_envs``.
        settings: arguments of ``make_env`` and ``FlowVectorEnv``; all others go to the task.
            Without ``seed`` each environment draws its own, as Gymnasium's do; ``reset(seed=...)``
            repeats episodes.

    Raises:
        ValueError: for unknown settings.
    """
    making, wrapping = (
        {name: settings.pop(name) for name in signature(takes).parameters if name in settings}
        for takes in (make_env, FlowVectorEnv)
    )
    flows = replace(making.pop("flows", Flows()), num_envs=num_envs)
    making.setdefault("seed", randbits(32))
    env = make_env(task=task(**settings), flows=flows, **making)
    return FlowVectorEnv(env, **wrapping)


def make_single(task: type[AbstractTask], **settings: Any) -> FlowSingleEnv:
    """Return an environment of one flow; arguments are those of ``make_vector``."""
    if "num_envs" in settings:
        raise ValueError("num_envs: gymnasium.make makes one flow; use gymnasium.make_vec")
    return FlowSingleEnv(make_vector(task, 1, autoreset_mode="Disabled", **settings))


for name, one in TASKS.items():
    register(
        name,
        entry_point=f"{__name__}:make_single",
        vector_entry_point=f"{__name__}:make_vector",
        kwargs={"task": one},
    )
