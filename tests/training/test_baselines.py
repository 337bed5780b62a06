"""Baselines fit the tasks that they name."""

from fishrl.envs import KarmanGait, Predation
from fishrl.envs.streams import Stream
from fishrl.modules import RandomPolicy
from fishrl.training.baselines import baseline, choose_baselines, find_baselines, make_baseline


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
