"""Benchmarks of flows, their steps, environments and training: what each measures."""

import os
import subprocess
import sys

import pytest
import torch

from experiments.benchmarks import flows
from experiments.benchmarks.environment import make_overhead, make_training
from experiments.benchmarks.flows import make_case, make_kernel_case, make_levels, make_solver
from experiments.benchmarks.machine import describe_machine
from experiments.benchmarks.measuring import FISH, KERNEL, BenchmarkSettings, Results, measure
from experiments.benchmarks.report import render_results
from experiments.benchmarks.steps import BURST, make_step, sum_memory, time_task
from fishrl.envs import Flows, Predation
from fishrl.physics import InPlaceSolver
from fishrl.training.settings import LearningSettings
from tests.envs.test_real_flow import TINY

SETTINGS = BenchmarkSettings()
TASK = Predation(**TINY | {"control_interval_T": 0.2, "checks_per_action": 5})  # few steps


@pytest.fixture(scope="module")
def solver() -> InPlaceSolver:
    """Return two small eager flows with a fish each."""
    return make_solver(16, has_fish=True, num_envs=2, compile=False)


def test_case_advances_whole_batch_or_first_flow(solver: InPlaceSolver) -> None:
    case = make_case(solver, "x", "one core")
    assert (case.scope, case.num_nodes) == (FISH, 2 * 160 * 80)
    one = make_case(solver, "x", "one core", num_flows=1)
    before = solver.body.age.clone()
    one.advance(4)
    assert (solver.body.age - before).tolist() == [4.0, 0.0]
    assert one.num_nodes == 160 * 80


def test_kernel_case_collides_without_moving_fish() -> None:
    flow = make_solver(16, has_fish=True, compile=False)
    case = make_kernel_case(flow, "x", "one core")
    flow.advance_(2)
    age, before = flow.body.age.clone(), flow.populations()
    case.advance(2)
    assert case.scope == KERNEL
    assert torch.equal(flow.body.age, age)
    assert not torch.equal(flow.populations(), before)


def test_listed_calls_equal_two_steps_of_solver() -> None:
    flow, twin = (make_solver(16, has_fish=True, compile=False) for _ in range(2))
    flow.advance_(2)  # which first locates the fish
    for parity in (0, 1):
        for part, arguments in flow.list_calls():
            part.run(*arguments[parity])
    twin.advance_(4)
    assert torch.equal(flow.populations(), twin.populations())


def test_step_of_a_task_begins_each_burst_where_the_last_one_did() -> None:
    case = make_step("tiny", TASK, compile=False)
    for _ in range(2):
        case.prepare()
        assert case.advance(BURST)["seconds"] > 0.0
    assert case.measured.keys() == {"collision", "exchange", "skin", "uncovering", "edges"}
    assert all(len(seconds) == 2 for seconds in case.measured.values())


def test_share_of_action_outside_flow_is_measured() -> None:
    (case,) = make_overhead(SETTINGS, task=TASK, flows=Flows(num_envs=2, compile=False))
    case.prepare()
    assert 0.0 < case.advance(1)["outside_flow"] < 1.0


def test_speed_and_memory_of_a_task_are_measured() -> None:
    measured, facts = time_task("predation-quick-v1", Flows(num_envs=1, compile=False), 1)
    assert facts == {"flows": 1, "period": 1.0}  # decisions per T
    assert min(*measured["first"], *measured["seconds"]) > 0.0
    before = sum_memory(os.getpid())
    child = subprocess.Popen(
        [sys.executable, "-c", "held = b'x' * 200_000_000; print(flush=True); input()"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    child.stdout.readline()
    assert sum_memory(os.getpid()) - before == pytest.approx(200e6, rel=0.2)
    child.communicate(b"\n")


def test_share_of_learning_is_measured() -> None:
    learning = LearningSettings(
        flows=Flows(num_envs=2, compile=False), batch_size=2, updates_per_frame=2.0
    )
    gradient, frame = make_training(SETTINGS, task=TASK, learning=learning)
    assert gradient.advance(2) is None
    assert 0.0 < frame.advance(1)["learning"] < 1.0


def test_levels_are_timed_by_beat_and_by_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(flows, "LEVELS", ((0.3, 1, (1,)), (0.3, 2, (1,))))
    settings = BenchmarkSettings(body_length=80, rounds=2, burst=1e-9)
    uniform, refined = cases = make_levels(settings, compile=False)
    assert refined.facts["period"] == pytest.approx(0.5 * uniform.facts["period"], rel=0.02)
    before = refined.prepare.args[1].state_dict()
    refined.prepare()
    after = refined.prepare.args[1].state_dict()
    assert all(torch.equal(after[name], value) for name, value in before.items())
    for case in cases:
        case.group = "levels"
    measure(cases, settings)
    parts = {"collision", "exchange", "skin", "uncovering", "edges"}
    assert uniform.measured.keys() == {"seconds", "cpu", *parts}
    assert refined.measured.keys() == {"seconds", "cpu", *parts, "interface"}
    table = render_results(
        Results(machine=describe_machine(), settings=vars(settings), cases=cases)
    )
    assert "| L = 24 | 2 levels |" in table
