"""Invalid return values of a task are named when its environment is made or first stepped."""

from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from fishrl.envs import AbstractTask, Command, Flows, Predation
from fishrl.envs.control import Steady
from fishrl.envs.control.control import Choice
from fishrl.envs.extensions import HasHistory, HasScene
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.scene import Arrow, Curve, Marks, Trail
from fishrl.envs.sense import Sense
from fishrl.physics import Boundaries, Fish, FlowConfig, InPlaceSolver
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
        ("senses", (Sense("x", ("x [L]",), lambda now: now["x"][:, None]),),
         "observe gives an observation besides senses"),
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


@pytest.mark.parametrize(("speed_bl", "most_bl"), [(0.2, 0.2), (0.7, 0.7), (0.02, 0.0)])
@pytest.mark.parametrize("when", ["flow_config", "place_"])
def test_stream_in_another_unit_is_refused_before_the_first_step(
    speed_bl: float, most_bl: float, when: str
) -> None:
    """Also one that the task does not name, although it may set T."""

    class Streaming(MaskedTask):
        max_stream_speed_bl: ClassVar[float] = most_bl
        unit: float = 1.0

        def flow_config(self) -> FlowConfig:
            speed = self.unit * speed_bl if when == "flow_config" else 0.0
            edges = Boundaries.make_stream()
            return replace(super().flow_config(), boundaries=edges, stream_speed=speed)

        def place_(self, solver: InPlaceSolver, rows: Tensor, starts: TensorDictBase) -> None:
            if when == "place_":
                solver.set_stream_speed_(torch.full((2,), self.unit * speed_bl), rows)
            super().place_(solver, rows, starts)

    with pytest.raises(ValueError, match=r"L/T.*max_stream_speed_bl|lower stream_speed|most 0.3"):
        _step(Streaming(**BRIEF))
    right = Streaming(**BRIEF, unit=0.0).scales.reference_speed
    if most_bl:
        _step(Streaming(**BRIEF, unit=right))


POINT, POINTS = (2, 2), (2, 3, 2)


@pytest.mark.parametrize(
    ("parts", "right", "wrong"),
    [
        ({"trails": (Trail(key="it"),)}, POINT, POINTS),
        ({"arrows": (Arrow(key="it", at="fish_centre", scale=1.0),)}, POINT, POINTS),
        ({"arrows": (Arrow(key="stream", at="it", scale=1.0),)}, POINT, POINTS),
        ({"marks": (Marks(key="it", radius=1.0, reach=2.0),)}, POINT, POINTS),
        ({"marks": (Marks(key="it", radius=1.0),)}, POINTS, (2, 1, 1, 2)),
        ({"marks": (Marks(key="it", radius=1.0),)}, POINT, (2,)),
        ({"curves": (Curve(key="it", colour=(0, 0, 0)),)}, POINTS, POINT),
        ({"curves": (Curve(key="it", colour=(0, 0, 0)),)}, POINTS, (2, 5, 3)),
    ],
)
def test_shape_of_what_is_drawn_is_refused_before_the_first_step(
    parts: dict[str, Any], right: tuple[int, ...], wrong: tuple[int, ...]
) -> None:
    def make(shape: tuple[int, ...]) -> AbstractTask:
        members = {
            "add_to_scene": lambda _, scene: scene.extend(**parts),
            "read_scene": lambda *_: {"it": torch.zeros(shape)},
        }
        return type("Drawn", (MaskedTask, HasScene), members)(**BRIEF)

    _step(make(right))
    with pytest.raises(ValueError, match=r"Drawn.read_scene 'it' gives a tensor of shape"):
        _step(make(wrong))


class _Live(MaskedTask, HasHistory):
    """Measures and senses tensors that the solver changes in place."""

    copies: bool = False
    num_samples: ClassVar[int] = 3

    def measure(self, solver: InPlaceSolver, starts: TensorDictBase) -> TensorDict:
        now = super().measure(solver, starts).set("place", solver.body.position)
        return now.set("frequency", solver.body.frequency).clone(self.copies)

    def sense(self, solver: InPlaceSolver, starts: TensorDictBase) -> dict[str, Tensor]:
        felt = solver.body.position
        return {"felt": felt.clone() if self.copies else felt}

    def reward(self, before: TensorDictBase, now: TensorDictBase) -> dict[str, Tensor]:
        return {"moved": (now["place"] - before["place"]).sum(-1)}


@pytest.mark.parametrize("num_envs", [1, 2])
def test_measurement_of_tensors_that_change_in_place_is_kept(num_envs: int) -> None:
    noted = []
    for copies in (False, True):
        env = FlowEnv(
            task=_Live(**BRIEF, copies=copies), flows=Flows(num_envs=num_envs, compile=False)
        )
        first, state = env.now, env.reset()
        for action in (1, 0, 1):
            state = env.step(state.set("action", torch.full((num_envs,), action)))["next"]
            noted.append((first.clone(), env.now.clone(), state["reward"].clone()))
    pairs = [
        pair for both in zip(noted[:3], noted[3:], strict=True) for pair in zip(*both, strict=True)
    ]
    assert all((live == copied).all() for live, copied in pairs)
    assert all(reward.abs().min() > 0.1 for *_, reward in noted)
    assert (noted[0][1]["felt"].diff(dim=1) != 0.0).any(-1).all()


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
