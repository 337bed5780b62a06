"""The tuned controller, on kinematic fish."""

from __future__ import annotations

import pytest
import torch

from examples.tune_controller import Budget, decode, make_controller, try_all, tune
from fishrl.envs import KarmanGait, make_env
from fishrl.envs.macro_actions import BendControl, MacroActions
from fishrl.training.baselines import make_pid
from tests.envs.conftest import SMALL

pytestmark = pytest.mark.usefixtures("kinematic")


def make_task() -> KarmanGait:
    control = BendControl(beat=MacroActions(rows=((0.5, 0.75, 1.0, 1.25),)))
    settings = {"wall_margin_bl": 0.25, "control_interval_T": 0.25, "checks_per_action": 6}
    return KarmanGait(**{**SMALL, **settings, "control": control, "time_limit": 60})


def test_zeros_are_the_untuned_controller() -> None:
    task, numbers = make_task(), torch.zeros(3, 7)
    untuned, decoded = make_pid(task), make_controller(task, decode(numbers))
    env = make_env(task=task, num_envs=3, compile=False)
    state = env.reset()
    for _ in range(4):
        expected = untuned(state.clone())["action"]
        assert torch.equal(decoded(state)["action"], expected)
        state = env.step_mdp(env.step(state))


def test_each_candidate_acts_in_its_own_flow() -> None:
    task = make_task()
    env = make_env(task=task, num_envs=2, compile=False)
    numbers = torch.stack((torch.zeros(7), torch.tensor([-2.0, *(6 * [0.0])])))
    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    both, decisions = try_all(env, task, numbers, starts)
    same, _ = try_all(env, task, numbers[1:].expand(2, 7), starts)
    assert both[1] == same[1] == same[0] != both[0]
    assert 0 < decisions <= 2 * 2 * task.time_limit


def test_search_keeps_its_budget_and_finds_a_better_controller() -> None:
    task, untuned = make_task(), torch.zeros(6, 7)
    numbers = tune(task, Budget(decisions=1000, candidates=6, starts=2), compile=False)
    env = make_env(task=task, num_envs=6, compile=False)
    starts = task.sample_starts(2, torch.Generator().manual_seed(5))
    before, _ = try_all(env, task, untuned, starts)
    after, _ = try_all(env, task, numbers.expand(6, 7), starts)
    assert after[0] > before[0]
