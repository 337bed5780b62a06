"""Benchmarks of flows: batches, kernels, memory."""

import pytest
import torch

from experiments.benchmarks.flows import make_case, make_kernel_case, make_solver
from experiments.benchmarks.measuring import FISH, KERNEL
from fishrl.physics import InPlaceSolver


@pytest.fixture(scope="module")
def solver() -> InPlaceSolver:
    """Return two small eager flows with a fish each."""
    return make_solver(16, has_fish=True, num_envs=2, compile=False)


def test_case_advances_whole_batch_or_first_flow(solver: InPlaceSolver) -> None:
    case = make_case(solver, "x", "one core")
    assert (case.scope, case.num_nodes) == (FISH, 2 * 160 * 80)
    assert case.working_set / case.num_nodes == pytest.approx(36, rel=0.3)
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
