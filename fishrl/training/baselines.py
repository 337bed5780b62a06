"""Baselines: hand-crafted controllers to compare learned policies with.

Each names the tasks that it fits. One for a task of your own stands next to the task::

    @baseline("steady", MyTask)
    def make_steady(task: MyTask, seed: int) -> SteadyPolicy:
        return SteadyPolicy()
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from fishrl.envs import Follower, KarmanGait, Predation, PredationPair
from fishrl.modules import (
    PID,
    FixedFrequency,
    GaitPolicy,
    InterceptPolicy,
    KeepCourse,
    KeepPlace,
    PursuitPolicy,
    RandomPolicy,
    bang_bang,
)
from fishrl.modules.gait_controllers import FrequencyController
from fishrl.physics import BounceBack
from fishrl.settings import checked, suggest

#: Makes a policy for a task, given the seed of its random numbers.
MakePolicy = Callable[[Any, int], TensorDictModuleBase]
M = TypeVar("M", bound=MakePolicy)

#: Numbers of ``tuned_pid``, to three digits (``studies/tuned_controller``): ``station_bl``,
#: ``gain`` and ``damping`` of ``PID``; ``gain``, ``damping``, ``bend_gain`` and ``yaw_damping`` of
#: ``KeepCourse``.
TUNED = (1.21, 2.25, 14.4, 8.79, 0.0667, 11.6, 0.0116)


class Baseline(NamedTuple):
    """A registered baseline, see ``baseline``."""

    name: str
    tasks: tuple[type, ...]
    make: MakePolicy
    fits: Callable[[Any], bool]
    is_default: bool


_REGISTERED: list[Baseline] = []


@checked
def baseline(
    name: str,
    *tasks: type,
    fits: Callable[[Any], bool] = lambda task: True,
    is_default: bool = True,
) -> Callable[[M], M]:
    """Register the decorated function, which makes a policy, as a baseline.

    Args:
        name: name of the baseline; a later registration replaces an earlier one for the same task.
        *tasks: classes of tasks that it can act in.
        fits: whether it can act in a task with its settings.
        is_default: compare learned policies with it by default.

    Raises:
        ValueError: without a class, or for a name that would be taken for a path.
    """
    if not tasks or "/" in name:
        raise ValueError(
            f"baseline {name!r}: give a name without a slash, and the class of its tasks, "
            "as in @baseline('mine', Predation)"
        )

    def register(make: M) -> M:
        _REGISTERED.append(Baseline(name, tasks, make, fits, is_default))
        return make

    return register


def find_baselines(task: Any) -> dict[str, Baseline]:
    """Return the baselines that fit a task by name, the last registered first."""
    found: dict[str, Baseline] = {}
    for each in reversed(_REGISTERED):
        if isinstance(task, each.tasks) and each.fits(task):
            found.setdefault(each.name, each)
    return found


def choose_baselines(names: Sequence[str] | None, task: Any) -> tuple[str, ...]:
    """Return the names of baselines of a task, by default all that learned policies compete with.

    Raises:
        ValueError: naming those that fit, if one does not.
    """
    known = find_baselines(task)
    if names is None:
        return tuple(name for name, each in known.items() if each.is_default)
    for name in names:
        if name not in known:
            raise ValueError(
                f"baseline {name!r}: {type(task).__name__} with these settings has "
                f"{', '.join(known)}{suggest(name, known)}"
            )
    return tuple(names)


def make_baseline(name: str, *, task: Any, seed: int) -> TensorDictModuleBase:
    """Make a baseline of a task; ``seed`` is that of random actions.

    Raises:
        ValueError: see ``choose_baselines``.
    """
    choose_baselines([name], task)
    return find_baselines(task)[name].make(task, seed)


@baseline("random", object)
def make_random(task: Any, seed: int) -> RandomPolicy:
    """Make random actions, a baseline of every task."""
    return RandomPolicy(seed=seed, num_numbers=_count_numbers(task))


def _count_numbers(task: Any) -> int | None:
    """Return how many numbers a continuous action has, None for discrete actions."""
    return None if task.action_bounds is None else task.num_actions


def _steers(task: Predation | PredationPair) -> bool:
    return task.bends or task.control.largest_turn > 0.0


@baseline("pursuit", Predation, PredationPair, fits=_steers)
def make_pursuit(task: Any, seed: int) -> PursuitPolicy:
    """Make pursuit of the food; each of two fish acts as if the other were not there."""
    return PursuitPolicy(**_choose_steering(task))


class Swimmer(NamedTuple):
    """How fast a fish of ``body_length`` nodes swims (L / T), and its tightest turn (L)."""

    body_length: int
    speed_bl: float
    turn_radius_bl: float


#: Measured by ``experiments.validation.turning.turn(gain=None, num_before=8, num_turns=6,
#: skin="bounce-back")["speed"]``; the radius is the speed in a turn of 15° per T over its rate. At
#: L = 32 with ``body_length=32, reynolds=2000, max_wall_speed=0.1``.
SHARP = (Swimmer(32, 0.45, 2.3), Swimmer(50, 0.57, 2.7))
IMMERSED = (Swimmer(50, 0.4, 1.7),)  # with the immersed boundary
BENDING = (Swimmer(32, 0.4, 2.5),)  # by 0.3 L


@baseline("intercept", Predation, fits=_steers)
def make_intercept(task: Any, seed: int) -> InterceptPolicy:
    """Make interception of the food, whose path the task reports, by a fish of nearest length."""
    known = SHARP if task.skin == BounceBack() else IMMERSED
    known = BENDING if task.bends else known
    _, speed, radius = min(known, key=lambda fish: abs(fish.body_length - task.body_length))
    return InterceptPolicy(speed_bl=speed, turn_radius_bl=radius, **_choose_steering(task))


def _choose_steering(task: Predation | PredationPair) -> dict[str, Any]:
    """Return how to turn; a fish that bends needs the gains of ``KeepCourse``."""
    turn, damping = (1.0 / 3.0, 0.1) if task.bends else (task.control.largest_turn, 0.0)
    return {"turn": turn, "yaw_damping_T": damping, "num_numbers": _count_numbers(task)}


@baseline("keep_place", Follower, fits=lambda task: task.control.largest_bend > 0.0)
def make_keep_place(task: Follower, seed: int) -> KeepPlace:
    """Make the controller that keeps a place in line behind the leader."""
    (low, *_, high), num_actions = task.control.rows[0], task.num_actions
    bend_bl = task.control.largest_bend
    return KeepPlace(bend_bl=bend_bl, frequency_range=(low, high), num_actions=num_actions)


def _beats(task: KarmanGait) -> bool:
    """Return whether actions choose the tail beat and perhaps a bend, but no turn."""
    return not task.control.largest_turn


@baseline(
    "shedding",
    KarmanGait,
    fits=lambda task: task.stream.has_disc and _beats(task),
    is_default=False,
)
def make_shedding(task: Any, seed: int) -> GaitPolicy:
    """Make a fish that beats at the shedding frequency of each flow; develops the wakes."""
    frequencies = task.wakes.shedding_frequencies * task.scales.period
    return make_gait_policy(FixedFrequency(frequencies.tolist()), task)


@baseline("bang_bang", KarmanGait, fits=_beats, is_default=False)
def make_bang_bang(task: KarmanGait, seed: int) -> GaitPolicy:
    """Make the controller that beats as fast as possible or not at all."""
    return make_gait_policy(bang_bang, task)


@baseline("passive", KarmanGait, fits=_beats, is_default=False)
def make_passive(task: KarmanGait, seed: int) -> GaitPolicy:
    """Make a fish that does not beat, as far as its actions allow."""
    return make_gait_policy(FixedFrequency(0.0), task)


@baseline("pid", KarmanGait, fits=_beats)
def make_pid(task: KarmanGait, seed: int = 0, *, station_bl: float | Tensor = 2.1) -> GaitPolicy:
    """Make a PID controller of the distance to the obstacle, with setpoints ``[B]`` or one."""
    control = task.control
    frequency: float | list[float] = 0.5 * control.max_frequency
    if control.num_flows is not None:  # the middle of each row roughly holds station
        frequency = [row[len(row) // 2] for row in _list_rows(task)]
    damping = 4.0 / task.interval_T  # per decision; 4 beats per T and L / T
    return make_gait_policy(PID(station_bl=station_bl, frequency=frequency, damping=damping), task)


@baseline(
    "tuned_pid", KarmanGait, fits=lambda task: task.control.largest_bend > 0.0, is_default=False
)
def make_tuned_pid(
    task: KarmanGait, seed: int = 0, *, numbers: Sequence[Any] = TUNED
) -> GaitPolicy:
    """Make ``pid`` for a fish that bends, with numbers that were searched in ``station-v1``.

    These are in the order and units of ``TUNED``, floats or ``[B]``.
    """
    station, gain, damping, course, course_damping, bend, yaw_damping = numbers
    policy = make_gait_policy(PID(station_bl=station, gain=gain, damping=damping), task)
    policy.course = KeepCourse(
        gain=course,
        damping=course_damping,
        bend_gain=bend,
        yaw_damping=yaw_damping,
        interval_T=task.interval_T,
    )
    return policy


def _list_rows(task: KarmanGait) -> tuple[tuple[float, ...], ...]:
    """Return the frequencies by gear of each flow, the same ones if there is one row for all."""
    rows, num = task.control.rows, len(task.stream.speeds_bl)
    return rows * num if len(rows) == 1 else rows


def make_gait_policy(controller: FrequencyController, task: KarmanGait) -> GaitPolicy:
    """Make the policy that follows a frequency controller with the control of the task."""
    control = task.control
    return GaitPolicy(
        controller=controller,
        course=KeepCourse(interval_T=task.interval_T) if control.largest_bend else None,
        rows=_list_rows(task),
        is_direct=control.num_flows is None,
        num_numbers=_count_numbers(task),
        flow_key="flow_class" if task.reads_flow_class else "flow_index",
    )
