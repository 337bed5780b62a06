"""Baselines: hand-crafted controllers of each task, by name.

Every task has ``random``. Your own task registers further ones::

    @find_baselines.register
    def _(task: MyTask) -> dict[str, Baseline]:
        return {"steady": Baseline(lambda seed: SteadyPolicy()), **find_random(task)}
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, singledispatch
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from fishrl.bounds import suggest
from fishrl.envs import AbstractTask, Follower, KarmanGait, Predation, PredationPair
from fishrl.envs.macro_actions import ContinuousFrequency, DirectFrequencies, MacroActions
from fishrl.modules import (
    PID,
    BangBang,
    FixedFrequency,
    GaitPolicy,
    InterceptPolicy,
    KeepPlace,
    PursuitPolicy,
    RandomPolicy,
)
from fishrl.modules.gait_controllers import FrequencyController


@dataclass(frozen=True)
class Baseline:
    """A policy to compare with.

    Args:
        make: makes it, given the seed of its random numbers.
        is_default: whether learned policies are compared with it by default.
    """

    make: Callable[[int], TensorDictModuleBase]
    is_default: bool = True


def find_random(task: AbstractTask) -> dict[str, Baseline]:
    """Return random actions, the baseline of every task."""
    num_numbers = None if task.action_bounds is None else task.num_actions
    return {"random": Baseline(lambda seed: RandomPolicy(seed=seed, num_numbers=num_numbers))}


@singledispatch
def find_baselines(task: Any) -> dict[str, Baseline]:
    """Return the baselines of a task by name; for a class of tasks register them, see above."""
    return find_random(task)


def list_baselines(task: Any) -> list[str]:
    """Name the baselines that a learned policy is compared with by default."""
    return [name for name, baseline in find_baselines(task).items() if baseline.is_default]


def make_baselines(
    names: Sequence[str] | None, *, task: Any, seed: int
) -> dict[str, TensorDictModuleBase]:
    """Make baselines by name, by default those of ``list_baselines``; see ``make_baseline``."""
    names = list_baselines(task) if names is None else names
    return {name: make_baseline(name, task=task, seed=seed) for name in names}


def make_baseline(name: str, *, task: Any, seed: int) -> TensorDictModuleBase:
    """Make a baseline of a task, or raise ValueError; ``seed`` is that of random actions."""
    known = find_baselines(task)
    if name not in known:
        raise ValueError(
            f"baseline {name!r}: {type(task).__name__} with these settings has "
            f"{', '.join(known)}{suggest(name, known)}"
        )
    return known[name].make(seed)


@find_baselines.register(Predation)
def find_pursuers(task: Any) -> dict[str, Baseline]:
    """Return the baselines of predation; *intercept* plans in whole T, from two observations."""
    how: dict[str, Any] = {
        "turn": math.radians(task.turn_degrees),
        "is_continuous": task.action_bounds is not None,
    }
    intercept = partial(
        InterceptPolicy,
        **how,
        food_speed_bl=task.food_speed_bl,
        food_limits_bl=task.food_limits_bl,
        food_start_bl=task.food_y_bl,
        food_still_T=task.food_still_T,
        food_direction={"up": 1, "down": -1}.get(task.food_direction, 0),
    )
    pursuit = {"pursuit": Baseline(lambda seed: PursuitPolicy(**how)), **find_random(task)}
    if task.num_stacked < 2 or not math.isclose(task.interval_T, 1.0, rel_tol=0.01):
        return pursuit
    return {"intercept": Baseline(lambda seed: intercept()), **pursuit}


@find_baselines.register
def _(task: PredationPair) -> dict[str, Baseline]:
    """Return pursuit of the food by each fish as if the other were not there."""
    turn, is_continuous = math.radians(task.turn_degrees), task.action_bounds is not None
    pursuit = partial(PursuitPolicy, turn=turn, is_continuous=is_continuous)
    return {"pursuit": Baseline(lambda seed: pursuit()), **find_random(task)}


@find_baselines.register
def _(task: KarmanGait) -> dict[str, Baseline]:
    """Return station-holding controllers, given the label that selects the task's row."""

    def follow(controller: FrequencyController) -> Baseline:
        return Baseline(lambda seed: make_gait_policy(controller, task), is_default=False)

    known = {
        "pid": Baseline(lambda seed: make_pid(task)),
        "passive": follow(FixedFrequency(0.0)),
        "bang_bang": follow(BangBang()),
        **find_random(task),
    }
    if task.stream.has_disc:  # in a free stream no vortices are shed
        known["shedding"] = Baseline(lambda seed: make_shedding(task), is_default=False)
    return known


@find_baselines.register
def _(task: Follower) -> dict[str, Baseline]:
    """Return the controller that keeps a place in line behind the leader."""
    keep = KeepPlace(
        turn=math.radians(task.turn_degrees),
        frequency_range=task.frequency_range,
        num_actions=task.num_actions,
    )
    return {"keep_place": Baseline(lambda seed: keep), **find_random(task)}


def make_shedding(task: KarmanGait) -> GaitPolicy:
    """Make the policy that beats with the shedding frequency of each flow; develops the wakes."""
    if task.wakes is None:
        raise ValueError("baseline 'shedding': in a free stream no vortices are shed")
    frequencies = task.wakes.shedding_frequencies * task.scales.period
    return make_gait_policy(FixedFrequency(frequencies.tolist()), task)


def make_pid(task: KarmanGait, *, station_bl: float | Tensor = 2.1) -> GaitPolicy:
    """Make a PID controller of the distance to the obstacle, with setpoints ``[B]`` or one."""
    frequency: float | list[float] = 0.5 * task.control.max_frequency
    if isinstance(task.control, MacroActions):  # the middle of each row about holds a station
        frequency = [row[len(row) // 2] for row in task.control.bank.rows]
    damping = 4.0 / task.interval_T  # per decision; 4 beats per T and L / T
    return make_gait_policy(PID(station_bl=station_bl, frequency=frequency, damping=damping), task)


def make_gait_policy(controller: FrequencyController, task: KarmanGait) -> GaitPolicy:
    """Make the policy that follows a frequency controller with the control of the task."""
    control = task.control
    if isinstance(control, DirectFrequencies):
        return GaitPolicy(controller=controller, rows=[control.frequencies], is_direct=True)
    if isinstance(control, ContinuousFrequency):
        return GaitPolicy(controller=controller, rows=control.rows, is_continuous=True)
    if not isinstance(control, MacroActions):
        raise ValueError(f"baselines cannot act through {type(control).__name__}")
    flow = "flow_class" if task.reads_flow_class else "flow_index"
    return GaitPolicy(controller=controller, rows=control.bank.rows, flow_key=flow)
