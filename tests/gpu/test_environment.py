"""Environments on a GPU, or on the pretended one of ``tests/pretend``: ``make test-gpu``."""

import sys
from functools import partial

import pytest
import torch
from tensordict import TensorDictBase

from fishrl.envs import Flows, Predation, make_env
from fishrl.physics import InPlaceSolver
from fishrl.physics.fast.stepper import Stepper
from tests.docs.test_tutorials import BRIEF
from tests.envs.test_real_flow import TINY
from tests.envs.test_real_wake import make_task as make_wake_task

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA"),
]


FLOW = TINY | BRIEF
TASKS = {"predation": lambda: Predation(**FLOW), "karman_gait": make_wake_task}


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
@pytest.mark.parametrize(
    ("name", "num_waits", "budget"), [("predation", 3, 2500), ("karman_gait", 4, 4000)]
)
def test_decision_neither_waits_nor_launches_many_operators_between_steps(
    name: str, num_waits: int, budget: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waits to check action and command before the flow advances, and for its end."""
    env = make_env(task=TASKS[name](), flows=Flows(num_envs=2, device="cuda", compile=False))
    state = first_legal(env.reset())
    with sys.modules["device"].Waits() as waits:
        env.step(state.clone())
    assert waits.total == num_waits, waits.lines
    monkeypatch.setattr(Stepper, "advance_", lambda *_: None)
    with sys.modules["device"].Waits() as waits:
        env.step(state)
    assert waits.launches <= budget
    env.close()


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
