"""Baselines fit the tasks that they name."""

from inspect import isabstract
from typing import Any

import pytest

from fishrl.envs import (
    AbstractTask,
    Flows,
    Follower,
    KarmanGait,
    Predation,
    PredationPair,
    make_env,
)
from fishrl.envs import control as controls
from fishrl.envs.agents import EachFish
from fishrl.envs.control import (
    Bend,
    ContinuousFrequency,
    Control,
    DirectFrequencies,
    MacroActions,
    Steady,
    Turn,
)
from fishrl.envs.streams import Stream
from fishrl.modules import RandomPolicy
from fishrl.training.baselines import baseline, choose_baselines, find_baselines, make_baseline
from tests.envs.conftest import SMALL
from tests.training.conftest import QUICK, Toy
from tests.training.toy_fish import ToyPredation

BEATS: list[Control] = [
    Steady(),
    MacroActions(rows=((0.25, 0.5, 1.0),)),
    DirectFrequencies(frequencies=(0.0, 0.5, 1.0)),
    ContinuousFrequency(frequency_range=(0.5, 1.0)),
    ContinuousFrequency(frequency_range=(0.5, 1.0), amplitude_range=(0.5, 1.0)),
]
TURNS: list[Control] = [Turn(turn_degrees=3.0, beat=beat) for beat in BEATS]
BENDS: list[Control] = [Bend(bend_bl=0.05, beat=beat) for beat in BEATS]


def test_default_baselines_are_those_of_the_task() -> None:
    for task in (Predation(), Predation(food_direction="random")):
        assert choose_baselines(None, task) == ("intercept", "pursuit", "random")
    free = KarmanGait(stream=Stream(has_disc=False))
    assert choose_baselines(None, free) == ("pid", "random")
    assert [*find_baselines(free)] == ["pid", "passive", "bang_bang", "random"]


def test_registered_baseline_fits_the_tasks_that_it_names() -> None:
    class Drift:
        action_bounds = None

    class Station(Drift):
        pass

    @baseline("steady", Station)
    def make_steady(task: Station, seed: int) -> RandomPolicy:
        return RandomPolicy(seed=seed)

    assert choose_baselines(None, Drift()) == ("random",)
    assert choose_baselines(None, Station()) == ("steady", "random")
    made = make_baseline("steady", task=Station(), seed=3)
    assert isinstance(made, RandomPolicy) and made.seed == 3


@pytest.mark.usefixtures("kinematic")
@pytest.mark.parametrize("kind", [Predation, PredationPair, KarmanGait, Follower])
def test_default_baselines_act_legally_or_are_left_out(kind: type[AbstractTask]) -> None:
    """Predators beat as fast as they can."""
    every = [*BEATS, *TURNS, *BENDS]
    kinds = [each for each in vars(controls).values() if isinstance(each, type)]
    kinds = [each for each in kinds if issubclass(each, Control) and not isabstract(each)]
    assert {type(control) for control in every} == {*kinds}
    fitting = {KarmanGait: BEATS + BENDS, Follower: BENDS}.get(kind, TURNS + BENDS)
    for control in every:
        if kind is Follower and control.action_bounds is None:
            continue
        sizes: dict[str, Any] = {**SMALL, "checks_per_action": 26, "control_interval_T": 0.5}
        task = kind(**sizes, control=control)
        names = {*choose_baselines(None, task)} - {"random"}
        assert bool(names) == (control in fitting)
        if not names:
            continue
        env = make_env(task=task, flows=Flows(num_envs=1, compile=False), seed=0)
        for name in names:
            policy, state = make_baseline(name, task=task, seed=0), env.reset()
            act = policy if task.num_fish == 1 else EachFish(policy)
            for _ in range(2):
                state = env.step_mdp(env.step(act(state)))
            frequency = float(env.base_env.solver.body.frequency) * task.scales.period
            assert kind in (KarmanGait, Follower) or frequency == pytest.approx(1.0)


def test_training_tries_its_baselines_before_it_learns(toy: Toy) -> None:
    @baseline("far", ToyPredation, is_default=False)
    def make_far(task: ToyPredation, seed: int) -> RandomPolicy:
        return RandomPolicy(seed=seed, num_numbers=9)

    training = toy.begin(**QUICK | {"baselines": ("random", "far")})
    with pytest.raises((RuntimeError, ValueError)) as caught:
        training.run()
    assert "'far'" in caught.value.__notes__[0] and training.counters.frames == 0
