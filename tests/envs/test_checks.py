"""A mistake in a task is named when its environment is made, or at its first step."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, cast

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import AbstractTask, Command, Predation
from fishrl.envs.flow_env import FlowEnv
from fishrl.physics import Fish
from fishrl.physics.bodies.gait import CARLING
from tests.envs.conftest import SMALL
from tests.envs.masked_task import MaskedTask

pytestmark = pytest.mark.usefixtures("kinematic")
BRIEF: dict[str, Any] = {**SMALL, "control_interval_T": 0.1, "checks_per_action": 4}


def _make(**members: Any) -> AbstractTask:
    """Return a task that differs from a good one in these members."""
    return cast(AbstractTask, type("Wrong", (MaskedTask,), members)(**BRIEF))


def _step(task: AbstractTask) -> None:
    env = FlowEnv(task=task, num_envs=2, compile_flow=False)
    env.step(env.reset().set("action", torch.tensor([0, 1])))


def _starts(x_bl: float, *without: str) -> Callable[..., TensorDict]:
    def starts_from(self: MaskedTask, uniform: torch.Tensor) -> TensorDict:
        starts = MaskedTask.starts_from(self, uniform)
        starts["head"][:, 0] += x_bl * self.body_length * (uniform[:, 0] > 0.5)
        return starts.exclude(*without)

    return starts_from


@pytest.mark.parametrize(
    ("member", "gives", "said"),
    [
        ("observe", lambda _, now: now["x"], r"observe gives .* \(2,\), .*expected .* \(2, 2\)"),
        ("observe", lambda _, now: torch.full((2, 2), torch.nan), "observe gives .*nan.* finite"),
        ("action_mask", lambda _, now: torch.zeros(2, 2) > 1, "a legal action in each row"),
        ("action_bounds", ((-1.0, 1.0),), "action_bounds gives .* expected .* of 2 numbers"),
        ("action_bounds", ((-1.0, 1.0), (2.0, 1.0)), "action_bounds gives"),
        ("is_terminated", lambda _, now: now["x"], "is_terminated gives .*64, expected .*bool"),
        ("report", lambda _, now: {"far": 1.0}, "report 'far' gives 1.0, expected"),
        ("success", "reached", r"success gives reached, expected .*\['beats'\]"),
        ("starts_from", _starts(20.0), "head at .*: the fish, or a part of it, lies outside"),
        ("command", lambda _, a, b: 0.1 * a, "command gives a tensor .* expected"),
        (
            "command",
            lambda _, a, b: Command(0.0 * a, 1.0 + a),
            r"frequency gives \[1.0, 2.0\], expected 0 to .* tail beats per step",
        ),
        (
            "command",
            lambda task, a, b: Command(0.0 * a, 0.0 * a + 2.2 / task.scales.period),
            "which is max_frequency = 2 per T",
        ),
        (
            "command",
            lambda _, a, b: Command(7.0 + 0.0 * a),
            r"turn gives \[7.0, 7.0\], expected radians, at most",
        ),
        (
            "command",
            lambda _, a, b: Command(0.0 * a, amplitude=1.0 + a),
            r"amplitude gives \[1.0, 2.0\], expected 0 to 1",
        ),
    ],
)  # fmt: skip
def test_a_wrong_answer_is_named(member: str, gives: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        _step(_make(**{member: gives}))


def test_a_size_that_is_forgotten_is_named() -> None:
    name = "num_actions"
    members = {
        key: value
        for key, value in vars(MaskedTask).items()
        if key != name and not key.startswith("__") and callable(value)
    }
    sizes = {key: 1 for key in ("n_obs", "num_actions", "num_draws") if key != name}
    forgetful = type("Forgetful", (AbstractTask,), {**members, **sizes})
    with pytest.raises(TypeError, match=rf"abstract.*{name}"):
        forgetful(**BRIEF)


def test_an_entry_of_success_may_be_a_column() -> None:
    _step(_make(success="arrived", report=lambda _, now: {"arrived": now["x"][:, None] < 1.0}))


class _WideBeats(Predation):
    @cached_property
    def fish(self) -> Fish:
        return Fish(body_length=self.body_length, gait=replace(CARLING, amplitude=0.2))


def test_the_time_step_follows_the_tail_of_the_tasks_own_fish() -> None:
    task = _WideBeats(max_wall_speed=0.07, wall_margin_bl=0.2)
    assert 0.068 < task.scales.tail_speed <= 0.07
