"""Tasks on levels: what is rounded, what is refused, and one decision of the real flow."""

from collections.abc import Mapping
from dataclasses import replace
from math import pi
from typing import Any

import pytest
import torch
from torch import Tensor

from fishrl.envs import AbstractTask, FlowEnv, Flows, Follower, KarmanGait, Predation
from fishrl.envs.control import DirectFrequencies, Turn
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.stations import SafeArea
from fishrl.envs.streams import Stream
from fishrl.envs.tasks.predation_pair import PredationPair
from fishrl.envs.views import make_scene, read_scene
from fishrl.envs.wakes import WakeBank, WakeRecipe
from tests.envs.conftest import make_streams, reset_rows

TASK: dict[str, Any] = {
    "body_length": 16,
    "reynolds": 400.0,
    "levels": 2,
    "wall_margin_bl": 0.7,
    "checks_per_action": 20,
}


@pytest.mark.parametrize("levels", [2, 3])
def test_period_actions_and_domain_are_rounded_to_levels(levels: int) -> None:
    task = Predation(**TASK | {"levels": levels, "body_length": 32})
    config = task.flow_config()
    assert task.scales.period % 2**levels == 0 and task.n_substeps == task.scales.period
    assert (config.width, config.height) == (321, 161)
    assert config.levels == levels


SHORT: dict[str, Any] = {
    "body_length": 20,
    "reynolds": 300.0,
    "max_wall_speed": 0.15,
    "levels": 2,
    "control_interval_T": 0.06,
    "checks_per_action": 2,
}
NARROW = Stream(speeds_bl=(1.0, 1.25), diameter_bl=(0.4, 0.6), face_bl=1.0, num_phases=1)
KARMAN: dict[str, Any] = {
    "control_interval_T": 0.12,
    "domain_bl": (4.0, 2.4),
    "stream": NARROW,
    "start_flows": (0, 1),
    "start_x_bl": (0.9, 1.0),
    "control": DirectFrequencies(frequencies=(0.5, 1.0)),
    "safe_area": SafeArea(near_bl=0.3, far_bl=1.5, aside_bl=0.5),
    "lateral_line": LateralLine(num_samples=1),
}
EVERY = (
    Predation(**SHORT, control=Turn(turn_degrees=5.0)),
    PredationPair(**SHORT, control=Turn(turn_degrees=5.0)),
    KarmanGait(**SHORT | KARMAN),
    Follower(**SHORT),
)


@pytest.mark.parametrize("task", EVERY, ids=lambda task: type(task).__name__)
def test_rows_of_every_task_are_alone(task: AbstractTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fishrl.envs.streams.load_wakes", lambda recipe, _: make_streams(recipe))
    flows = Flows(num_envs=2, compile=False, num_workers=0)
    env, twin = (FlowEnv(task=task, flows=flows, seed=1) for _ in range(2))
    acted = env.step(env.rand_action(env.reset()))["next"]
    assert not acted["done"].any()
    twin.load_state_dict(env.state_dict())
    solver, num = env.solver, len(task.flow_config().list_grids())
    every = [solver.populations(grid)[1:] for grid in range(num)]
    every[-1].fill_(torch.nan)
    solver.set_populations_(every, torch.tensor([False, True]))
    action = env.rand_action(acted.clone())
    lost, same = (each.step(action.clone())["next"] for each in (env, twin))
    assert lost["diverged"].flatten().tolist() == [False, True]
    _assert_equal_rows(lost.flatten_keys(), same.flatten_keys())
    _assert_equal_rows(solver.state_dict(), twin.solver.state_dict())
    before = solver.state_dict()
    reset = reset_rows(env, False, True)
    _assert_equal_rows(before, solver.state_dict())
    assert all(value.isfinite().all() for value in solver.state_dict().values())
    assert not reset["done"].any() and not solver.is_diverged().any()


@pytest.mark.parametrize("task", EVERY[:2], ids=lambda task: type(task).__name__)
def test_outline_of_the_patch_is_drawn_on_request_and_holds_the_fish(task: AbstractTask) -> None:
    env = FlowEnv(task=task, flows=Flows(num_envs=2, compile=False, num_workers=0), seed=1)
    assert all(curve.is_filled for curve in make_scene(task).curves)
    scene, values = make_scene(task, shows_levels=True), read_scene(task, env.solver, env.start)
    (outline,) = [curve for curve in scene.curves if not curve.is_filled]
    (dots,) = [trail for trail in scene.trails if trail.is_dotted]
    corners = values[outline.key]
    assert torch.equal(values[dots.key], corners[:, 0])
    low, high = corners[:, :1], corners[:, 2:3]
    (_, (width, height, _)) = task.flow_config().list_grids()
    assert (high - low == torch.tensor([width - 1, height - 1])).all()
    for index in range(task.num_fish):
        markers = env.solver.markers(index)
        assert ((markers > low) & (markers < high)).all()


def _assert_equal_rows(one: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> None:
    """Assert that row 0 of two states is the same, bit for bit."""
    pairs = {name: (value[0], other[name][0]) for name, value in one.items()}
    assert [name for name, (a, b) in pairs.items() if not torch.equal(a, b)] == []


#: A fish far enough from the disc to have a patch of its own.
FAR: dict[str, Any] = {
    "domain_bl": (5.0, 3.4),
    "start_x_bl": (1.4, 1.5),
    "safe_area": SafeArea(near_bl=1.0, far_bl=2.0, aside_bl=0.3),
}


def test_episode_begins_in_the_wake_on_all_grids(monkeypatch: pytest.MonkeyPatch) -> None:
    """The grids of the disc are the wake's; a fish that is far has a patch, which they fill."""

    def shed(recipe: WakeRecipe, _: str) -> WakeBank:
        bank = make_streams(recipe)
        noise = [1e-4 * torch.randn(f.shape, generator=generator) for f in bank.populations]
        return replace(
            bank, populations=[f + n for f, n in zip(bank.populations, noise, strict=True)]
        )

    generator = torch.Generator().manual_seed(0)
    monkeypatch.setattr("fishrl.envs.streams.load_wakes", shed)
    for changes, own in (({}, [0, 1]), (FAR, [0, 2])):
        task = KarmanGait(**SHORT | KARMAN | changes)
        env = FlowEnv(task=task, flows=Flows(num_envs=2, compile=False, num_workers=0), seed=1)
        wake = task.wakes.take(env.start["flow_index"], env.start["wake_phase"])
        for grid, f in zip(own, wake, strict=True):
            assert torch.equal(env.solver.populations(grid), f)
    rho, u = (field[:, :, 24] for field in env.solver.macroscopic())
    assert rho.std() > 1e-5 and not env.solver.is_diverged().any()
    inside = env.solver.markers(0).mean(1, keepdim=True)
    assert env.solver.sample(inside)[1][..., 0].min() > 0.5 * float(u[:, 0].mean())


def test_fish_that_turns_back_to_the_disc_ends_its_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fishrl.envs.streams.load_wakes", lambda recipe, _: make_streams(recipe))
    task = KarmanGait(**SHORT | KARMAN | FAR)
    env = FlowEnv(task=task, flows=Flows(num_envs=2, compile=False, num_workers=0), seed=1)
    solver, middle = env.solver, task.origin[1]
    places = torch.tensor([[[70.0, middle], task.disc_places[0]]], dtype=torch.float64)
    places, heading = places.repeat(2, 1, 1), torch.tensor([[0.0, pi]] * 2, dtype=torch.float64)
    every = torch.ones(2, dtype=torch.bool)
    solver.reset_(every, places, heading)
    tail = solver.markers()[..., 0].amin(1)
    places[:, 0, 0] += task.wake_patches.least_x - tail + torch.tensor([0.5, -0.5])
    solver.reset_(every, places, heading)
    now = task.measure(solver, env.start)
    assert task.is_terminated(now).tolist() == [False, True]
    assert task.name_endings(now)["turned back to the obstacle"].tolist() == [False, True]
    assert not solver.is_diverged().any()
    places[1, 0, 0] -= task.travel + 1.5  # farther than it moves between two checks
    with pytest.raises(ValueError, match="a body is not within its patch"):
        solver.reset_(every, places, heading)
