"""The fish one can name on a command line."""

from __future__ import annotations

import math
from typing import Any

from tensordict.nn import TensorDictModuleBase

from experiments.checkpointing import BrainOf, load_checkpoint, read_metadata
from experiments.settings import ConfigError, nearest
from fishrl.modules import InterceptPolicy, PursuitPolicy, RandomPolicy, make_actor

NAMES = ("random", "pursuit", "intercept")


def make_policy(name: str, *, task: Any, seed: int) -> TensorDictModuleBase:
    """Make a hand-written fish.

    Args:
        name: random, pursuit or intercept.
        task: whose food it is after; the intercepting fish is told the food's route.
        seed: of the random one.

    Raises:
        ConfigError: if there is none of that name.
    """
    if name not in NAMES:
        raise ConfigError(
            f"policy={name}: there is no {name!r}.{nearest(name, NAMES)} "
            f"There is: {', '.join(NAMES)}."
        )
    if name == "random":
        return RandomPolicy(seed=seed)
    turn = math.radians(task.turn_degrees)
    if name == "pursuit":
        return PursuitPolicy(turn=turn)
    return InterceptPolicy(
        turn=turn,
        food_speed_bl=task.food_speed_bl,
        food_limits_bl=task.food_limits_bl,
        food_start_bl=task.food_y_bl,
        food_still_T=task.food_still_T,
        food_direction={"up": 1, "down": -1}.get(task.food_direction, 0),
    )


def load_policy(checkpoint: str, *, task: Any, device: str) -> TensorDictModuleBase:
    """Load the learned fish of a run folder or a checkpoint.

    Args:
        checkpoint: where it lies.
        task: what it shall do; the task it has learned.
        device: where it shall think.

    Raises:
        ValueError: if the checkpoint is missing, corrupt, or of another task.
    """
    brain = BrainOf.task_of(task)
    path, metadata = read_metadata(checkpoint)
    brain.check(metadata, path=path)
    actor = make_actor(
        num_inputs=brain.num_inputs,
        num_actions=brain.num_actions,
        hidden=metadata["config"]["hidden"],
    ).to(device)
    load_checkpoint(path, {"actor": actor}, brain=brain, device=device)
    return actor
