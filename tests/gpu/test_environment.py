"""Environments on a GPU, or on the pretended one of ``tests/pretend``: ``make test-gpu``."""

import sys
from dataclasses import replace
from functools import partial

import pytest
import torch
from tensordict import TensorDictBase

import fishrl.envs.flow_env
from fishrl.envs import Flows, Predation, make_env
from fishrl.envs.control import Turn
from fishrl.physics import InPlaceSolver
from tests.docs.test_tutorials import BRIEF
from tests.envs.conftest import move_kinematically
from tests.envs.test_levels import SHORT
from tests.envs.test_real_flow import TINY
from tests.envs.test_real_wake import make_task as make_wake_task

pytestmark = pytest.mark.gpu


FLOW = TINY | BRIEF
TASKS = {
    "predation": lambda: Predation(**FLOW),
    "karman_gait": make_wake_task,
    "levels": lambda: Predation(**SHORT, control=Turn(turn_degrees=5.0)),
}


def first_legal(state: TensorDictBase) -> TensorDictBase:
    return state.set("action", state["action_mask"].int().argmax(-1))


@pytest.mark.parametrize("name", TASKS)
def test_environment_on_a_gpu_equals_that_on_a_cpu(name: str) -> None:
    """Three decisions, a saved and restored state; single precision."""
    task, rollouts = TASKS[name](), []
    for device in ("cuda", "cpu"):
        env = make_env(task=task, flows=Flows(num_envs=2, device=device, compile=False), seed=0)
        rollouts.append(env.rollout(3, policy=first_legal, break_when_any_done=False))
        env.base_env.load_state_dict(env.base_env.state_dict())
        env.close()
    there, here = rollouts
    assert there.device.type == "cuda"
    for key in ("observation_stack", "reward", "done", "action_mask"):
        got, expected = there["next", key].cpu(), here["next", key]
        torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.skipif("device" not in sys.modules, reason="the pretended device alone counts")
@pytest.mark.parametrize("name", TASKS)
def test_decision_and_reset_are_one_graph_each(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All but one of 28 and of 37 launches are TorchRL's, and copies."""
    move_kinematically(monkeypatch)
    env = make_env(task=TASKS[name](), flows=Flows(num_envs=2, device="cuda", compile=False))
    state = env.reset()
    for _ in range(2):  # as written, then recorded
        _, state = env.step_and_maybe_reset(first_legal(state))
    with sys.modules["device"].Waits() as waits:
        env.step(first_legal(state))
    assert waits.total == 1, waits.lines
    assert waits.launches <= 30
    env.reset()
    with sys.modules["device"].Waits() as waits:
        env.reset()
    assert waits.total == 4, waits.lines  # all TorchRL's
    assert waits.launches <= 40
    env.close()


@pytest.mark.parametrize("name", TASKS)
def test_graphs_change_no_bit(
    name: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Episodes end and begin in between, in one row or in all."""
    move_kinematically(monkeypatch)
    make = partial(make_env, flows=Flows(num_envs=2, device="cuda", compile=False))
    task = replace(TASKS[name](), time_limit=2)
    with monkeypatch.context() as patch:
        patch.setattr(fishrl.envs.flow_env, "Repeated", lambda run, what: run)
        as_written = make(task=task)
    results = []
    for env in (make(task=task), as_written):
        state, steps = env.reset(), []
        for number in range(8):
            step, state = env.step_and_maybe_reset(first_legal(state))
            steps.append(step)
            if number == 2:
                state = env.reset(state.set("_reset", torch.tensor([[True], [False]]).cuda()))
        results.append((torch.stack(steps), env.base_env.solver.state_dict()))
    (repeated, here), (written, there) = results
    assert (repeated == written).all()
    assert all(torch.equal(here[name], there[name]) for name in there)
    assert not caplog.records


class Reading(Predation):
    """A task that reads a number on the host."""

    def is_terminated(self, now: TensorDictBase) -> torch.Tensor:
        assert now["clearance"].max().item() > 0.0
        return super().is_terminated(now)


def test_task_that_reads_on_the_host_runs_as_written_which_is_logged_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    move_kinematically(monkeypatch)
    env = make_env(task=Reading(**FLOW), flows=Flows(num_envs=2, device="cuda", compile=False))
    env.rollout(4, policy=first_legal)
    (line,) = caplog.messages
    assert line.startswith("a decision is no CUDA graph and waits for the GPU")


@pytest.mark.parametrize("num_before", [0, 2])
def test_graph_refuses_an_illegal_action(num_before: int, monkeypatch: pytest.MonkeyPatch) -> None:
    move_kinematically(monkeypatch)
    env = make_env(task=Predation(**FLOW), flows=Flows(num_envs=2, device="cuda", compile=False))
    state = env.reset()
    for _ in range(num_before):
        env.step(first_legal(state))
    for action in (7, -1):
        state["action"] = torch.tensor([1, action], device="cuda")
        with pytest.raises(ValueError, match=f"action = {action} in row 1: legal is"):
            env.step(state)
    env.step(first_legal(state))


@pytest.mark.parametrize(("first", "second"), [("cuda", "cpu"), ("cpu", "cuda")])
def test_flows_continue_from_a_state_of_another_device(first: str, second: str) -> None:
    make = partial(InPlaceSolver, config=Predation(**FLOW).flow_config(), num_envs=2, compile=False)
    one, other = solvers = [make(device=device) for device in (first, second)]
    rows = torch.tensor([True, True])
    for solver in solvers:
        solver.reset_(rows)
        solver.body.frequency.fill_(1e-3)
        f = solver.populations().cpu() + 1e-3  # rows and fields from the host
        solver.set_populations_(f[:1], torch.tensor([True, False]))
        torch.testing.assert_close(solver.populations().cpu()[0], f[0])
        solver.advance_(2, torch.tensor([True, False]))
        assert solver.sample(torch.full((2, 3, 2), 9.0))[0].device.type == solver.device.type
    one.advance_(4)
    other.load_state_dict({name: value.to(second) for name, value in one.state_dict().items()})
    assert torch.equal(one.populations().to(second), other.populations())
    for solver in solvers:
        solver.advance_(4)
    here, there = one.populations().to(second), other.populations()
    torch.testing.assert_close(here, there, rtol=0, atol=1e-6)
