"""The flows that the benchmark times: batches, kernels, memory."""

import pytest
import torch

from experiments.benchmarks.flows import (
    make_case,
    make_kernel_case,
    make_solver,
)
from experiments.benchmarks.measuring import FISH, KERNEL
from fishrl.physics import InPlaceSolver


@pytest.fixture(scope="module")
def solver() -> InPlaceSolver:
    """Return two small flows with a fish in each, eager."""
    return make_solver(16, has_fish=True, num_envs=2, compile=False)


def test_a_case_advances_all_flows_of_a_batch_or_the_first(solver: InPlaceSolver) -> None:
    case = make_case(solver, "x", "one core")
    assert (case.scope, case.num_nodes) == (FISH, 2 * 160 * 80)
    assert case.working_set / case.num_nodes == pytest.approx(36, rel=0.3)
    one = make_case(solver, "x", "one core", num_flows=1)
    before = solver.body.age.clone()
    one.advance(4)
    assert (solver.body.age - before).tolist() == [4.0, 0.0]
    assert one.num_nodes == 160 * 80


def test_the_kernel_alone_collides_and_moves_no_fish() -> None:
    flow = make_solver(16, has_fish=True, compile=False)
    case = make_kernel_case(flow, "x", "one core")
    flow.advance_(2)
    age, before = flow.body.age.clone(), flow.populations()
    case.advance(2)
    assert case.scope == KERNEL
    assert torch.equal(flow.body.age, age)
    assert not torch.equal(flow.populations(), before)


def test_the_calls_of_two_steps_are_those_of_the_solver() -> None:
    flow, twin = (make_solver(16, has_fish=True, compile=False) for _ in range(2))
    for parity in (0, 1):
        for part, arguments in flow.list_calls():
            part.run(*arguments[parity])
    twin.advance_(2)
    assert torch.equal(flow.populations(), twin.populations())
