"""The tuned controller, on kinematic fish."""

from __future__ import annotations

from types import MethodType
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import TransformedEnv

from examples.tune_controller import CONTROLLERS, Budget, Controller, try_all, tune
from fishrl.envs import KarmanGait, make_env
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.macro_actions import BendControl, MacroActions
from fishrl.training.baselines import make_pid
from tests.envs.conftest import SMALL

pytestmark = pytest.mark.usefixtures("kinematic")


def make_task() -> KarmanGait:
    control = BendControl(beat=MacroActions(rows=((0.5, 0.75, 1.0, 1.25),)))
    settings: dict[str, Any] = {
        "wall_margin_bl": 0.25,
        "control_interval_T": 0.25,
        "checks_per_action": 6,
    }
    line = LateralLine(features=("ahead", "left", "pressure"))
    settings |= {"control": control, "time_limit": 60, "lateral_line": line}
    return KarmanGait(**{**SMALL, **settings})


@pytest.fixture(params=CONTROLLERS)
def controller(request: pytest.FixtureRequest) -> Controller:
    return CONTROLLERS[request.param]


def try_numbers(
    controller: Controller, env: TransformedEnv, task: KarmanGait, numbers: Tensor, seed: int
) -> tuple[Tensor, int]:
    starts = task.sample_starts(2, torch.Generator().manual_seed(seed))
    return try_all(env, controller.make(task, controller.decode(numbers)), starts)


def test_zeros_are_the_untuned_controller() -> None:
    task, sight = make_task(), CONTROLLERS["sight"]
    untuned, decoded = make_pid(task), sight.make(task, sight.decode(torch.zeros(3, 7)))
    env = make_env(task=task, num_envs=3, compile=False)
    state = env.reset()
    for _ in range(4):
        expected = untuned(state.clone())["action"]
        assert torch.equal(decoded(state)["action"], expected)
        state = env.step_mdp(env.step(state))


def test_each_candidate_acts_in_its_own_flow(controller: Controller) -> None:
    task = make_task()
    env = make_env(task=task, num_envs=2, compile=False)
    numbers = torch.zeros(2, len(controller.untuned))
    numbers[1, 0] = -2.0
    both, decisions = try_numbers(controller, env, task, numbers, 0)
    same, _ = try_numbers(controller, env, task, numbers[1:].expand(2, -1), 0)
    assert both[1] == same[1] == same[0] != both[0]
    assert 0 < decisions <= 2 * 2 * task.time_limit


@pytest.mark.parametrize("senses", ["sight", "lateral_line"])
def test_search_keeps_its_budget_and_finds_a_better_controller(senses: str) -> None:
    controller = CONTROLLERS[senses]
    task, untuned = make_task(), torch.zeros(6, len(controller.untuned))
    budget = Budget(decisions=1000, candidates=6, starts=2)
    numbers = tune(controller, task, budget, compile=False)
    env = make_env(task=task, num_envs=6, compile=False)
    before, _ = try_numbers(controller, env, task, untuned, 5)
    after, _ = try_numbers(controller, env, task, numbers.expand(6, -1), 5)
    assert after[0] > before[0]


@pytest.mark.parametrize("senses", ["own_motion", "lateral_line"])
def test_a_reflected_fish_bends_the_other_way(senses: str) -> None:
    task, controller = make_task(), CONTROLLERS[senses]
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(len(controller.untuned), 1, generator=generator).expand(-1, 2)
    policy = controller.make(task, values)
    one = torch.randn(3, 2, 5, 3, generator=generator)
    other = one[:, :, [0, 2, 1, 4, 3]] * torch.tensor([1.0, -1.0, 1.0])
    rates = torch.randn(3, generator=generator)
    for step, rate in enumerate(rates):
        state = TensorDict(
            {
                "lateral_line": torch.stack((one[step], other[step])),
                "yaw_rate": torch.stack((rate, -rate)),
                "is_init": torch.full((2, 1), step == 0),
            },
            [2],
        )
        assert isinstance(policy.course, MethodType) and isinstance(policy.controller, MethodType)
        bend, beat = policy.course(state), policy.controller(state, torch.zeros(2).long())
        torch.testing.assert_close(bend[0], -bend[1])
        torch.testing.assert_close(beat[0], beat[1])
        assert bend[0] != 0
