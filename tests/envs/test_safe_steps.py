"""Checks that cannot find an end are skipped without changing episodes."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from fishrl.envs import AbstractTask, Predation
from fishrl.envs.control import Bend, Turn
from tests.envs.conftest import SMALL, act, make_flows, move_kinematically, starts_at
from tests.envs.test_karman_gait import make_task as make_gait_task
from tests.envs.test_real_flow import TINY
from tests.envs.test_real_wake import make_task as make_wake_task


def run(task: AbstractTask, num_actions: int, **options: Any) -> tuple[list[TensorDict], int]:
    """Return every step of random actions, with resets, and the number of stops."""
    env, count = make_flows(task, 4, seed=7, **options), 0
    advance_ = env.solver.advance_

    def count_and_advance_(num_steps: int, rows: torch.Tensor) -> None:
        nonlocal count
        count += 1
        advance_(num_steps, rows)

    env.solver.advance_ = count_and_advance_  # type: ignore[method-assign]
    draw, state, steps = torch.Generator().manual_seed(3), env.reset(), []
    for _ in range(num_actions):
        action = (torch.rand(4, 3, generator=draw) * state["action_mask"]).argmax(-1)
        step, state = env.step_and_maybe_reset(state.set("action", action))
        steps.append(step["next"].clone())
    return steps, count


HUNT = Predation(**SMALL, control=Turn(turn_degrees=40.0), food_direction="random")


@pytest.mark.parametrize(
    ("task", "num_actions", "share"),
    [(HUNT, 60, 0.5), (make_gait_task(start_y_bl=(-0.8, 0.8)), 30, 0.95)],
)
def test_skipped_checks_change_no_episode(
    task: AbstractTask, num_actions: int, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    move_kinematically(monkeypatch)
    some, num_some = run(task, num_actions)
    monkeypatch.setattr(type(task), "count_safe_steps", AbstractTask.count_safe_steps)
    every, num_every = run(task, num_actions)
    for one, other in zip(some, every, strict=True):
        assert (one == other).all()
    assert sum(int(step["terminated"].sum()) for step in every) > 5
    caught = [step["captured"].any() for step in every if "captured" in step]
    assert task is not HUNT or any(caught)  # at the food and at walls
    assert num_some < share * num_every


class Passing(Predation):
    """Also ends while the food is 2.1 to 2.2 L ahead."""

    def is_terminated(self, now: TensorDictBase) -> torch.Tensor:
        ahead = -now["target"][..., 0]
        return super().is_terminated(now) | (ahead > 2.1) & (ahead < 2.2)


def test_further_ends_of_a_subclass_are_not_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    move_kinematically(monkeypatch)
    env = make_flows(Passing(**SMALL), 1, starts=starts_at((4.8, 2.5)))
    env.reset()
    assert act(env, 1)["terminated"].all()


def find_largest_speed(
    monkeypatch: pytest.MonkeyPatch, task: AbstractTask, actions: list[list[int]]
) -> float:
    """Return the largest speed of a marker, nodes per step, in actions of two flows."""
    env = make_flows(task, 2, seed=1)
    env.reset()
    largest, last = 0.0, env.solver.markers()
    step = env.solver.advance_

    def advance_(num_steps: int, rows: torch.Tensor) -> None:
        nonlocal largest, last
        for _ in range(num_steps // 2):
            step(2, rows)
            moved = (env.solver.markers() - last).norm(dim=-1).max()
            largest, last = max(largest, float(moved) / 2.0), env.solver.markers()

    monkeypatch.setattr(env.solver, "advance_", advance_)
    for action in actions:  # from rest, turning to both sides
        env.step(TensorDict({"action": torch.tensor(action)}, env.batch_size))
    return largest


@pytest.mark.parametrize("bends", [False, True])
def test_fish_stays_below_its_assumed_speed(monkeypatch: pytest.MonkeyPatch, bends: bool) -> None:
    control = Bend(bend_bl=0.2) if bends else Turn(turn_degrees=12.0)
    task = Predation(**TINY | {"wall_margin_bl": 0.3}, control=control)
    largest = find_largest_speed(monkeypatch, task, [[0, 2], [0, 1]])
    clearance = torch.tensor([task.wall_margin + 1.0])
    at_rest = {"clearance": clearance, "target": torch.full((1, 4), 99.0)}
    speed = 1.0 / float(task.count_safe_steps(TensorDict(at_rest, [1])))
    assert 0.2 * speed < largest < 0.9 * speed


def test_fish_in_a_stream_stays_below_the_assumed_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    task = make_wake_task()
    largest = find_largest_speed(monkeypatch, task, [[1, 2], [0, 2]])
    place = torch.tensor([[1.0, 0.0]])
    far = {"clearance": torch.tensor([999.0]), "place": place}
    margin = task.safe_area.measure_margin(place) * task.body_length
    speed = float(margin / task.count_safe_steps(TensorDict(far, [1])))
    assert 0.2 * speed < largest < 0.9 * speed
