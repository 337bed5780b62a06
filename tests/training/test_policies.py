"""Policies are loaded for the task they were trained for, and evaluated as at the end of a run."""

from dataclasses import replace
from typing import Any

import pytest

from fishrl.envs import Flows, Oracle, PredictedFlowLabel, TrueFlowLabel
from fishrl.training import Algorithm, evaluate, load_plan, load_policy
from fishrl.training.policies import prepare
from fishrl.zoo import find_policy
from tests.training.conftest import ACTOR_CRITICS, QUICK, Toy
from tests.training.toy_fish import ToyPredation


@pytest.mark.parametrize("algorithm", ACTOR_CRITICS, ids=lambda a: type(a).__name__)
def test_evaluate_reproduces_the_final_evaluation_of_a_run(toy: Toy, algorithm: Algorithm) -> None:
    task = {"is_continuous": algorithm.takes_continuous}
    few = QUICK | {"final_episodes": 10}
    summary = toy.begin(name="run", algorithm=algorithm, task=task, **few).run()
    result = evaluate(toy.folder / "run", episodes=10, flows=Flows(compile=False))
    assert result == {name: summary[name] for name in result}


@pytest.mark.usefixtures("kinematic")
@pytest.mark.parametrize("is_task_given", [False, True])
def test_flows_are_labelled_as_in_the_run_by_default(is_task_given: bool) -> None:
    run, labelled_by = find_policy("gait_sharp"), list[set[type]]()
    given: Any = {"task": load_plan(run).task} if is_task_given else {}
    for source in ({}, {"recognition": Oracle()}, {"recognition": None}):
        env, _ = prepare(run, **given, **source, flows=Flows(num_envs=1, compile=False))
        types = {type(transform) for transform in env.transform}
        labelled_by.append(types & {PredictedFlowLabel, TrueFlowLabel})
    assert labelled_by == [{PredictedFlowLabel}, {TrueFlowLabel}, set()]


def test_evaluate_takes_baseline_names_and_policies() -> None:
    given: dict[str, Any] = {"task": ToyPredation(), "flows": Flows(compile=False)}
    rates = [evaluate(name, episodes=16, **given) for name in ("random", "pursuit")]
    assert rates[0]["success_rate"] < rates[1]["success_rate"]
    still = evaluate(lambda td: td.set("action", td["start_index"] * 0 + 1), episodes=4, **given)
    assert still["episodes"] == 4
    with pytest.raises(ValueError, match="did you mean 'pursuit'"):
        evaluate("pursiut", **given)


def test_policy_with_its_senses_in_another_order_is_refused() -> None:
    task = load_plan("zoo/gait_bend_blind_line").task
    task = replace(task, observes=task.observes[::-1])
    with pytest.raises(ValueError, match=r"senses = \['lateral line', 'own motion'\]: the policy"):
        load_policy("zoo/gait_bend_blind_line", task=task)
