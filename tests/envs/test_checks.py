"""Invalid return values of a task are named when its environment is made or first stepped."""

from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from fishrl.envs import AbstractTask, Command, Flows, Predation
from fishrl.envs.control import Steady
from fishrl.envs.control.control import Choice
from fishrl.envs.flow_env import FlowEnv
from fishrl.physics import Fish
from fishrl.physics.bodies.gait import CARLING
from tests.envs.conftest import SMALL
from tests.envs.small_tasks import MaskedTask

pytestmark = pytest.mark.usefixtures("kinematic")
BRIEF: dict[str, Any] = {**SMALL, "control_interval_T": 0.25, "checks_per_action": 12}


def _make(**members: Any) -> AbstractTask:
    """Return a task that differs from a valid one in these members."""
    return type("Wrong", (MaskedTask,), members)(**BRIEF)


def _step(task: AbstractTask) -> None:
    env = FlowEnv(task=task, flows=Flows(num_envs=2, compile=False))
    env.step(env.reset().set("action", torch.tensor([0, 1])))


def _start_outside(task: MaskedTask, uniform: torch.Tensor) -> TensorDict:
    starts = MaskedTask.starts_from(task, uniform)
    starts["head"][:, 0] += 20.0 * task.body_length * (uniform[:, 0] > 0.5)
    return starts


@pytest.mark.parametrize(
    ("member", "gives", "said"),
    [
        ("observe", lambda _, now: now["x"], r"observe gives .* \(2,\), .*expected .* \(2, 2\)"),
        ("observe", lambda _, now: torch.full((2, 2), torch.nan), "observe gives .*nan.* finite"),
        ("action_mask", lambda _, now: torch.zeros(2, 2) > 1, "a legal action in each row"),
        ("action_bounds", ((-1.0, 1.0),), "action_bounds gives .* expected .* of 2 numbers"),
        ("action_bounds", ((-1.0, 1.0), (2.0, 1.0)), "action_bounds gives"),
        ("is_terminated", lambda _, now: now["x"], "is_terminated gives .*64, expected .*bool"),
        ("n_obs", 0, "n_obs gives 0, expected senses, or n_obs and observe"),
        ("reward", lambda _, before, now: now["x"], "reward gives .* expected named terms"),
        ("reward", lambda _, before, now: {"far": now["x"][:, None]},
         r"reward 'far' gives .*\(2, 1\).*, expected a tensor of shape \(2,\)"),
        ("report", lambda _, now: {"far": 1.0}, "report 'far' gives 1.0, expected"),
        ("report", lambda _, now: {"near": torch.zeros(2, 3, 4, dtype=torch.bool)},
         r"report 'near' gives .*, expected .* booleans \[B\] or \[B, n\]"),
        *[("report", lambda _, now, name=name: {name: now["x"] < 1.0},
           f"report gives '{name}', expected names that neither") for name in
          ("success", "done", "diverged", "step_count", "reward/progress", "action")],
        ("success", "reached", r"success gives reached, expected .*\['beats'\]"),
        ("starts_from", _start_outside, "head at .*: the fish, or a part of it, lies outside"),
        ("command", lambda _, a, b: 0.1 * a, "command gives a tensor .* expected"),
        ("command", lambda _, a, b: Command(frequency=1.0 + a),
         r"frequency gives \[1.0, 2.0\], expected 0 to .* tail beats per step"),
        ("command", lambda task, a, b: Command(frequency=0.0 * a + 2.2 / task.scales.period),
         "which is max_frequency = 2 per T"),
        ("command", lambda _, a, b: Command(7.0 + 0.0 * a),
         r"turn gives \[7.0, 7.0\], expected at most 0.78 radians: nose and tail"),
        ("command", lambda _, a, b: Command(bend=0.1 * a),
         r"command gives bend=..., expected turn=..., since the motion of the fish is Commanded"),
        ("command", lambda _, a, b: Command(amplitude=1.0 + a),
         r"amplitude gives \[1.0, 2.0\], expected 0 to 1"),
    ],
)  # fmt: skip
def test_invalid_return_value_is_named(member: str, gives: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        _step(_make(**{member: gives}))


@pytest.mark.parametrize("name", ["arrived", "success"])
def test_success_entry_may_be_a_column(name: str) -> None:
    _step(_make(success=name, report=lambda _, now: {name: now["x"][:, None] < 1.0}))


def test_safe_steps_may_be_integers() -> None:
    _step(_make(count_safe_steps=lambda _, now: torch.full(now.shape, 10)))


class _Veering(Steady):
    action_names: ClassVar[tuple[str, ...]] = ("straight", "left")

    def choose(self, action: Tensor, gear: Tensor, flow: Tensor) -> Choice:
        return super().choose(action, gear, flow)._replace(turn=0.1 * action.double())


def test_control_must_state_its_largest_turn() -> None:
    with pytest.raises(ValueError, match=r"_Veering.choose gives a turn: give its largest_turn"):
        _step(Predation(**BRIEF, control=_Veering()))


class _WideBeats(Predation):
    @cached_property
    def fish(self) -> Fish:
        return replace(super().fish, gait=replace(CARLING, amplitude=0.2))


def test_period_follows_the_tail_speed_of_the_tasks_fish() -> None:
    task = _WideBeats(max_wall_speed=0.07, wall_margin_bl=0.2)
    assert 0.068 < task.scales.tail_speed <= 0.07
