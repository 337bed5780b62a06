"""The example that learns by gradients through the flow, in small real flows."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from examples.gradient_control import (
    Approach,
    OutOfTime,
    Settings,
    Swimmers,
    Watch,
    make_policy,
    train_sac,
    train_shac,
    unroll,
)
from fishrl.envs import FlowEnv

#: The coarsest fish, and decisions of ten steps.
BRIEF: dict[str, Any] = {"control_interval_T": 0.12, "checks_per_action": 5}


def act(number: int, rows: int) -> Tensor:
    """Return an action ``[B, 2]``."""
    return torch.sin(torch.arange(2.0 * rows).view(rows, 2) + number)


def test_swimmers_and_the_env_have_the_same_flows_and_rewards() -> None:
    task = Approach(**BRIEF)
    swimmers = Swimmers(task, 2, seed=3, compile=False)
    env = FlowEnv(task=task, num_envs=2, compile_flow=False, starts=swimmers.starts)
    env.reset()
    for number in range(4):
        action = act(number, 2)
        reward, terminated, _ = swimmers.step(action)
        step = env.step(TensorDict({"action": action}, [2]))["next"]
        torch.testing.assert_close(
            step["observation"], task.observe(swimmers.now), rtol=0, atol=1e-5
        )
        torch.testing.assert_close(step["reward"][:, 0], reward.float(), rtol=0, atol=1e-6)
        assert not terminated.any()


def test_the_gradient_of_a_window_equals_central_differences() -> None:
    """Of each row's return with respect to a step of all weights of the policy."""
    task, settings = Approach(**BRIEF), Settings(horizon=2)
    actor = make_policy(settings).double()
    critic = torch.nn.Linear(task.n_obs, 1, dtype=torch.float64)
    weights = dict(actor.named_parameters())
    along = {name: torch.randn_like(value) for name, value in weights.items()}

    def go(shift: Tensor) -> Tensor:
        torch.manual_seed(0)
        swimmers = Swimmers(task, 2, compile=False, dtype=torch.float64)
        moved = {name: value.detach() + shift * along[name] for name, value in weights.items()}
        call = partial(torch.func.functional_call, actor, moved)
        return unroll(swimmers, lambda td: call((td,)), critic, settings)[0]

    shift = torch.zeros((), dtype=torch.float64, requires_grad=True)
    returned = go(shift)
    got = [torch.autograd.grad(each, shift, retain_graph=True)[0] for each in returned]
    with torch.no_grad():
        rise = (go(shift + 1e-5) - go(shift - 1e-5)) / 2e-5
    torch.testing.assert_close(torch.stack(got), rise, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("train", [train_shac, train_sac])
def test_training_keeps_policies_until_its_time_is_out(train: Callable[..., None]) -> None:
    watch, settings = Watch(2e-3, num=2), Settings(num_envs=2, horizon=2, compile=False)
    with pytest.raises(OutOfTime):
        train(Approach(**BRIEF), watch, settings)
    (first, before), (last, after) = watch.kept
    assert 0 < first["frames"] <= last["frames"]
    assert last["set_up_seconds"] > 0.0
    assert all(value.isfinite().all() for value in after.parameters())
    assert before is not after
