"""Small tasks, with and without a flow."""

from math import pi
from typing import Any

import pytest
import torch
from tensordict import TensorDict

import fishrl.envs.flow_env
import fishrl.envs.streams
from fishrl.envs import AbstractTask, FlowEnv, Flows, Predation
from fishrl.envs.control import ContinuousFrequency, Turn
from fishrl.envs.wakes import WakeBank, WakeRecipe
from fishrl.physics.collision import compute_equilibrium
from tests.envs.kinematic_solver import KinematicSolver

#: Smallest scales that the units and the wall margin allow: fast, not accurate.
SMALL: dict[str, Any] = {
    "body_length": 20,
    "reynolds": 500.0,
    "max_wall_speed": 0.15,
    "wall_margin_bl": 0.15,
    "levels": 1,
}
#: Turns and tail-beat frequencies as numbers.
CONTINUOUS = Turn(beat=ContinuousFrequency(frequency_range=(0.5, 1.0)))


def move_kinematically(patch: pytest.MonkeyPatch) -> None:
    """Replace flows by fish that move at constant speed, and wakes by undisturbed streams."""
    patch.setattr(fishrl.envs.flow_env, "InPlaceSolver", KinematicSolver)
    patch.setattr(fishrl.envs.streams, "load_wakes", lambda recipe, _: make_streams(recipe))


def make_streams(recipe: WakeRecipe) -> WakeBank:
    """Return undisturbed streams in place of wakes, which take minutes to develop."""
    speed, streams = torch.tensor(recipe.speeds).view(-1, 1, 1, 1), []
    for width, height, _ in recipe.config.list_grids():
        ux = speed.expand(-1, 1, height, width)
        none = torch.zeros_like(ux)
        streams.append(torch.stack(compute_equilibrium(none, ux, none), 2))
    return WakeBank(populations=streams, shedding_frequencies=torch.ones(len(speed)))


@pytest.fixture
def small_task() -> Predation:
    return Predation(**SMALL)


def make_flows(task: AbstractTask, num_envs: int, **options: Any) -> FlowEnv:
    """Return the bare environment, eager."""
    return FlowEnv(task=task, flows=Flows(num_envs=num_envs, compile=False), **options)


def act(env: FlowEnv, *actions: int, **inputs: Any) -> TensorDict:
    """Take one action per row, with further inputs, and return what follows."""
    entries = {name: torch.tensor(value) for name, value in inputs.items()}
    step = env.step(TensorDict({"action": torch.tensor(actions), **entries}, env.batch_size))
    return step["next"]


def keep_straight(state: TensorDict) -> TensorDict:
    """Take action 1 in each row, which turns no fish."""
    return state.set("action", torch.ones(state.shape, dtype=torch.int64, device=state.device))


def starts_at(*heads: tuple[float, float], heading: float = pi, up: float = 1.0) -> TensorDict:
    """Return starts of predation with noses at ``heads``, in body lengths of the small task."""
    num = len(heads)
    return TensorDict(
        {
            "head": torch.tensor(heads, dtype=torch.float64) * SMALL["body_length"],
            "heading": torch.full((num,), heading, dtype=torch.float64),
            "food_direction": torch.full((num,), up, dtype=torch.float64),
        },
        [num],
    )


def reset_rows(env: FlowEnv, *rows: bool) -> TensorDict:
    return env.reset(TensorDict({"_reset": torch.tensor(rows)[:, None]}, env.batch_size))


def read_flows(env: FlowEnv) -> dict[str, torch.Tensor]:
    """Return everything about real flows and their bodies, rows first."""
    bodies = {
        f"{name}_{i}": values.clone()
        for i, body in enumerate(env.solver.bodies)
        for name, values in body._asdict().items()
    }
    flows = {"populations": env.solver.populations(), "speed": env.solver.stream_speed.clone()}
    return {**flows, **bodies, **env.now.clone().to_dict()}
