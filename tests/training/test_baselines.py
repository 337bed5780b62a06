"""A task brings its baselines."""

from __future__ import annotations

from pathlib import Path

import pytest

from fishrl.envs import KarmanGait, Predation
from fishrl.envs.streams import Stream
from fishrl.modules import RandomPolicy
from fishrl.training.baselines import (
    Baseline,
    find_baselines,
    find_random,
    list_baselines,
    make_baseline,
)


class Drift:
    action_bounds = None


def test_tasks_are_compared_with_their_own_baselines() -> None:
    assert list_baselines(Predation()) == ["intercept", "pursuit", "random"]
    for other in (Predation(control_interval_T=0.5), Predation(num_stacked=1)):
        assert list_baselines(other) == ["pursuit", "random"]  # intercept plans in whole T
    free = KarmanGait(stream=Stream(has_disc=False))
    assert list_baselines(free) == ["pid", "random"]
    assert list_baselines(Predation(action="continuous")) == list_baselines(Predation())
    assert set(find_baselines(free)) == {"pid", "passive", "bang_bang", "random"}


def test_a_new_task_has_random_actions_and_what_is_registered_for_it() -> None:
    assert list_baselines(Drift()) == ["random"]

    class Station(Drift):
        pass

    @find_baselines.register(Station)
    def _(task: Station) -> dict[str, Baseline]:
        return {"steady": Baseline(lambda seed: RandomPolicy(seed=seed)), **find_random(task)}

    assert list_baselines(Station()) == ["steady", "random"]
    assert isinstance(make_baseline("steady", task=Station(), seed=3), RandomPolicy)


def test_an_unknown_baseline_is_refused_with_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"has intercept, pursuit, random; did you mean 'pursuit'"):
        make_baseline("pursiut", task=Predation(), seed=0)
    with pytest.raises(ValueError, match="has pursuit, random"):
        make_baseline("intercept", task=Predation(control_interval_T=0.5), seed=0)


def test_an_unknown_baseline_is_refused_before_wakes_are_developed(tmp_path: Path) -> None:
    task = KarmanGait(stream=Stream(wake_folder=str(tmp_path / "wakes")))
    with pytest.raises(ValueError, match="has pid, passive, bang_bang, random, shedding"):
        make_baseline("nobody", task=task, seed=0)
    assert not list(tmp_path.iterdir())
