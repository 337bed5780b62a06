"""What a caller sets globally in torch changes no flow, and no training fails for it."""

import random
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Any

import pytest
import torch

from fishrl.envs import Flows, Predation, make_env
from fishrl.physics import BounceBack, DCylinder, FlowConfig, ImmersedBoundary, InPlaceSolver, Skin
from tests.envs.conftest import CONTINUOUS
from tests.envs.test_real_flow import TINY
from tests.training.conftest import QUICK, Toy, read_rows

State = Callable[[], AbstractContextManager[Any]]


@contextmanager
def setting(change: Callable[[Any], None], value: Any, before: Any) -> Iterator[None]:
    """Change something global for a block."""
    change(value)
    try:
        yield
    finally:
        change(before)


use_dtype = partial(setting, torch.set_default_dtype, before=torch.float32)
STATES: dict[str, State] = {
    "float64": partial(use_dtype, torch.float64),
    "bfloat16": partial(use_dtype, torch.bfloat16),
    "autocast": partial(torch.autocast, "cpu", torch.bfloat16),
    "inference": torch.inference_mode,
    "no_grad": torch.no_grad,
    "deterministic": partial(setting, torch.use_deterministic_algorithms, True, before=False),
    "device": partial(setting, torch.set_default_device, "meta", before=None),
}
ACTIONS = torch.tensor([[[-0.5, 0.5]], [[1.0, 1.0]]])


def step_env(skin: Skin, state_of: Callable[[], State]) -> list[dict[Any, torch.Tensor]]:
    """Make, reset, step twice and roll out, each call in a state of its own; return all results.

    Actions come from a policy that learns, so that they require gradients.
    """
    task = Predation(
        **TINY, control=CONTINUOUS, control_interval_T=0.25, checks_per_action=6, skin=skin
    )
    with state_of()():
        env = make_env(task=task, flows=Flows(num_envs=1, compile=False), seed=3)
    with state_of()():
        state = env.reset()
    results = [state.clone()]
    for action in ACTIONS:
        state["action"] = action.clone().requires_grad_() * 1.0
        with state_of()():
            step, state = env.step_and_maybe_reset(state)
        results.append(step.clone())
    with state_of()():
        results.append(env.rollout(1, lambda td: td.set("action", ACTIONS[0])))
    flows = env.base_env.solver.state_dict()
    return [*(dict(td.flatten_keys().items()) for td in results), flows]


def step_solver(skin: Skin, state_of: Callable[[], State]) -> list[dict[Any, torch.Tensor]]:
    """Make, reset and advance flows, each call in a state of its own; return all results."""
    body = DCylinder(diameter=8)
    config = FlowConfig(width=48, height=40, tau=0.6, bodies=(body,), skin=skin)
    with state_of()():
        solver = InPlaceSolver(config=config, num_envs=2, compile=False)
    rows = torch.tensor([True, False])
    for call in (
        partial(solver.reset_, rows, velocity=(0.01, 0.0)),
        partial(solver.advance_, 4),
        partial(solver.command_, torch.tensor([0.1, 0.0], dtype=torch.float64), 4),
        partial(solver.advance_, 4),
    ):
        with state_of()():
            call()
    with state_of()():
        rho, u = solver.macroscopic()
    return [solver.state_dict(), {"rho": rho, "u": u, "diverged": solver.is_diverged()}]


@pytest.fixture(scope="module")
def plain() -> dict[Any, list[dict[Any, torch.Tensor]]]:
    """Return what flows do without any global state."""
    return {
        (run, skin): run(skin, lambda: torch.enable_grad)
        for run in (step_env, step_solver)
        for skin in (ImmersedBoundary(), BounceBack())
    }


@pytest.mark.parametrize("run", [step_env, step_solver])
@pytest.mark.parametrize("name", STATES)
def test_torch_state_changes_no_flow(
    name: str, run: Any, plain: dict[Any, list[dict[Any, torch.Tensor]]]
) -> None:
    draw = random.Random(f"{name} {run.__name__}")
    skin = draw.choice([ImmersedBoundary(), BounceBack()])
    kinds = [STATES[name], torch.enable_grad]
    drawn: list[State] = [STATES[name]]  # at least once, then alternating at random

    def state_of() -> State:
        return drawn.pop() if drawn else draw.choice(kinds)

    for got, expected in zip(run(skin, state_of), plain[run, skin], strict=True):
        assert got.keys() == expected.keys()
        for key, value in expected.items():
            assert got[key].dtype == value.dtype, key
            assert torch.equal(got[key], value), key


def test_global_torch_state_changes_no_training(toy: Toy, whole: Any) -> None:
    with STATES["float64"](), STATES["autocast"](), STATES["inference"]():
        training = toy.begin(name="run", **QUICK)
        training.run()
    assert toy.rows("run") == read_rows(whole.folder.path)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int16, torch.int32, torch.bool])
def test_actions_of_every_integer_type_mean_the_same(dtype: torch.dtype) -> None:
    task = Predation(**TINY, control_interval_T=0.25, checks_per_action=6)
    env, other = (
        make_env(task=task, flows=Flows(num_envs=1, compile=False), seed=3) for _ in range(2)
    )
    one = torch.ones(1)
    got, expected = (
        each.step(each.reset().set("action", action))["next", "observation"]
        for each, action in ((env, one.to(dtype)), (other, one.long()))
    )
    assert torch.equal(got, expected)


@pytest.mark.parametrize("device", ["foo", "mps", "cuda:7"])
def test_device_that_is_not_there_is_refused(device: str) -> None:
    config = FlowConfig(width=32, height=24, tau=0.6)
    for make in (
        lambda: InPlaceSolver(config=config, num_envs=1, device=device),
        lambda: make_env(task=Predation(**TINY), flows=Flows(num_envs=1, device=device)),
    ):
        with pytest.raises(ValueError, match=f"device = '{device}': must be cpu, cuda"):
            make()
