"""Flows in processes of their own: what happens when one fails, and what is left behind."""

import gc
import os

import pytest
import torch

from fishrl.physics import FlowConfig, InPlaceSolver
from fishrl.physics.fast.workers import SharedMemory, count_cores, map_shared

CONFIG = FlowConfig(width=32, height=24, tau=0.6)


def make_solver(num_workers: int) -> InPlaceSolver:
    solver = InPlaceSolver(config=CONFIG, num_envs=2, compile=False, num_workers=num_workers)
    f = torch.zeros(2, 9, 24, 32)
    f[:, 1, 10, 10] = 0.01
    solver.set_populations_(f)
    return solver


def test_flows_in_processes_move_as_flows_here_do() -> None:
    here, there = make_solver(0), make_solver(2)
    for solver in (here, there):
        solver.advance_(6)
    assert here.populations().abs().max() > 0
    assert torch.equal(here.populations(), there.populations())
    there.close()


def test_a_worker_that_dies_ends_the_run_with_an_error_that_says_what_to_do() -> None:
    solver = make_solver(2)
    solver.advance_(2)
    assert solver._workers is not None
    solver._workers._processes[1].kill()
    with pytest.raises(RuntimeError, match="a flow worker failed: it ended with exit status -9"):
        solver.advance_(2)


def test_closing_ends_the_processes_and_leaves_no_file() -> None:
    solver = make_solver(2)
    solver.advance_(2)
    assert solver._workers is not None and solver._shared is not None
    processes = list(solver._workers._processes)
    solver.close()
    assert all(process.poll() is not None for process in processes)
    assert not solver._shared.path.exists()
    with pytest.raises(RuntimeError, match="closed and cannot advance: make a new one"):
        solver.advance_(2)


def test_a_solver_that_never_ran_leaves_no_file() -> None:
    solver = make_solver(2)
    assert solver._shared is not None
    path = solver._shared.path
    assert path.exists()
    del solver
    gc.collect()
    assert not path.exists()


def test_shared_memory_is_seen_by_all_who_map_it() -> None:
    memory = SharedMemory(64)
    other = map_shared(str(memory.path), 64)
    memory.unlink()
    memory.tensor[3] = 7
    assert int(other[3]) == 7


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux alone tells")
def test_flows_use_the_cores_that_the_process_was_given() -> None:
    given = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(given)})
        assert count_cores() == 1
    finally:
        os.sched_setaffinity(0, given)
    assert count_cores() == len(given)
