"""The fish one can name on a command line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from experiments.settings import ConfigError, nearest
from fishrl.envs import KarmanGait
from fishrl.envs.macro_actions import DirectFrequencies, MacroActions
from fishrl.modules import (
    PID,
    BangBang,
    FixedFrequency,
    GaitPolicy,
    InterceptPolicy,
    PursuitPolicy,
    RandomPolicy,
)
from fishrl.modules.gait_controllers import FrequencyController
from fishrl.training.algorithms import build_algorithm
from fishrl.training.checkpoint import BrainOf, load_checkpoint, read_metadata

#: Hand-written fish: those that are after food, and those that hold a station.
NAMES = ("random", "pursuit", "intercept", "passive", "shedding", "bang_bang", "pid")


def list_baselines(task: Any) -> list[str]:
    """Name the hand-written fish that a learned one is compared with; a new task has but chance."""
    if isinstance(task, KarmanGait):
        return ["pid", "random"]
    if not _has_food(task):
        return ["random"]
    return ["intercept", "pursuit", "random"] if _decides_once_per_T(task) else ["random"]


def _decides_once_per_T(task: Any) -> bool:
    """Return whether decisions are a T apart, as those hunters take them to be."""
    return math.isclose(task.interval_T, 1.0, rel_tol=0.01)


def make_baselines(
    names: Sequence[str] | None, *, task: Any, seed: int
) -> dict[str, TensorDictModuleBase]:
    """Make the hand-written fish that a learned one is compared with.

    Args:
        names: of them; by default those of ``list_baselines``.
        task: see ``make_policy``.
        seed: see ``make_policy``.

    Raises:
        ConfigError: if there is none of a name, or it cannot do this task.
    """
    names = list_baselines(task) if names is None else names
    return {name: make_policy(name, task=task, seed=seed, setting="baselines") for name in names}


def make_policy(
    name: str, *, task: Any, seed: int, setting: str = "policy"
) -> TensorDictModuleBase:
    """Make a hand-written fish.

    Args:
        name: one of ``NAMES``.
        task: whose food it is after (the intercepting fish is told the food's route), or whose
            station it holds.
        seed: of the random one.
        setting: that names it, for errors.

    Raises:
        ConfigError: if there is none of that name, or it cannot do this task.
    """
    if name not in NAMES:
        raise ConfigError(
            f"{setting}={name}: there is no {name!r}.{nearest(name, NAMES)} "
            f"There is: {', '.join(NAMES)}."
        )
    if name == "random":
        return RandomPolicy(seed=seed)
    is_hunter = name in ("pursuit", "intercept")
    if not (_has_food(task) if is_hunter else isinstance(task, KarmanGait)):
        raise ConfigError(f"{setting}={name}: that fish has nothing to do in {type(task).__name__}")
    return _make_hunter(name, task, setting) if is_hunter else _make_holder(name, task, setting)


def _has_food(task: Any) -> bool:
    return hasattr(task, "food_speed_bl")


def _make_hunter(name: str, task: Any, setting: str) -> TensorDictModuleBase:
    if not _decides_once_per_T(task):
        raise ConfigError(
            f"{setting}={name}: that fish decides once per T, here a decision takes "
            f"{task.interval_T:.3g} T; set control_interval_T=1, or take {setting}=random"
        )
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


def _make_holder(name: str, task: KarmanGait, setting: str) -> GaitPolicy:
    """Make a fish that holds its station; it is told which flow it is in."""
    if name == "pid":
        return make_pid(task)
    if name == "bang_bang":
        return make_gait_policy(BangBang(), task)
    if name == "passive":
        return make_gait_policy(FixedFrequency(0.0), task)
    if task.wakes is None:
        raise ConfigError(f"{setting}=shedding: in a free stream no vortices are shed")
    shed = task.wakes.shedding_frequencies * task.scales.period
    return make_gait_policy(FixedFrequency(shed.tolist()), task)


def make_pid(task: KarmanGait, *, station_bl: float | Tensor = 2.1) -> GaitPolicy:
    """Make a fish that holds ``station_bl`` behind the obstacle; one number, or ``[B]``."""
    frequency: float | list[float] = 0.5 * task.control.max_frequency
    if isinstance(task.control, MacroActions):  # the middle of each row holds, more or less
        frequency = [row[len(row) // 2] for row in task.control.bank.rows]
    damping = 4.0 / task.interval_T  # per decision; 4 beats per T and L / T
    return make_gait_policy(PID(station_bl=station_bl, frequency=frequency, damping=damping), task)


def make_gait_policy(controller: FrequencyController, task: KarmanGait) -> GaitPolicy:
    """Make the policy that follows a frequency controller with the task's control."""
    control = task.control
    if isinstance(control, DirectFrequencies):
        return GaitPolicy(controller=controller, rows=[control.frequencies], is_direct=True)
    if not isinstance(control, MacroActions):
        raise ConfigError(f"hand-written fish cannot handle {type(control).__name__}")
    flow = "flow_class" if task.reads_flow_class else "flow_index"
    return GaitPolicy(controller=controller, rows=control.bank.rows, flow_key=flow)


def load_policy(
    checkpoint: str, *, task: Any, device: str, num_told: int = 0
) -> TensorDictModuleBase:
    """Load the learned fish of a run folder or a checkpoint.

    Args:
        checkpoint: where it lies.
        task: what it shall do; the task it has learned.
        device: where it shall think.
        num_told: see ``Recognition``.

    Raises:
        ValueError: if the checkpoint is missing, corrupt, or of another task.
    """
    brain = BrainOf.task_of(task, num_told=num_told)
    path, metadata = read_metadata(checkpoint)
    brain.check(metadata, path=path)
    config = metadata["config"]
    actor = build_algorithm(config).make_policy(brain, hidden=config["hidden"]).to(device)
    load_checkpoint(path, {"actor": actor}, brain=brain, device=device)
    return actor
