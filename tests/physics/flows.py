"""Flows that tests of the physics advance: by readable steps, or in place."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from fishrl.physics import FlowConfig, FlowState, ImmersedBoundary, InPlaceSolver, Scales
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.flow import FlowParams, make_params, make_uniform
from fishrl.physics.step import step

SCALES = Scales.from_budget(body_length=24, reynolds=800.0, max_wall_speed=0.1)
ONE = torch.ones(1, dtype=torch.float64)


def make_tank(**changes: Any) -> FlowConfig:
    """Return a tank of 4 L x 3 L for the fish of ``SCALES``, with an immersed boundary."""
    changes = {"skin": ImmersedBoundary()} | changes
    return make_swimmer_config(SCALES, length_bl=4, height_bl=3, **changes)


def place_body(
    x: float, y: float, heading: float = 0.0, frequency: float = 0.0, **values: Any
) -> BodyState:
    """Return one body in float64, with further values of its state."""
    body = make_body(torch.tensor([[x, y]], dtype=torch.float64), heading * ONE, frequency * ONE)
    given = {name: torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
    return body._replace(**given)


def start_stream(
    config: FlowConfig, *bodies: BodyState, velocity: tuple[float, float] = (0.0, 0.0)
) -> FlowState:
    """Return one flow in float64 that has a velocity everywhere."""
    none = torch.zeros(1, config.height, config.width, dtype=torch.float64)
    return FlowState(make_uniform(none, none + velocity[0], none + velocity[1]), bodies)


def measure_polygon(corners: Tensor) -> tuple[float, Tensor]:
    """Return area and centre of a polygon ``[N, 2]`` (shoelace)."""
    x, y = corners.unbind(-1)
    cross = x * y.roll(-1) - y * x.roll(-1)
    sums = torch.stack((((x + x.roll(-1)) * cross).sum(), ((y + y.roll(-1)) * cross).sum()))
    return 0.5 * float(cross.sum().abs()), sums / (3.0 * cross.sum())


def advance(
    state: FlowState, config: FlowConfig, num_steps: int, params: FlowParams | None = None
) -> FlowState:
    """Return the state after many readable steps."""
    params = params or make_params([config] * len(state.f))
    for _ in range(num_steps):
        state = step(state, config, params)
    return state


def read_state(solver: InPlaceSolver) -> FlowState:
    """Return the state at which flows begin, in float64, for readable steps."""
    bodies = read_bodies(solver)
    time = torch.zeros(solver.num_envs, dtype=torch.float64)
    return FlowState(solver.populations().double(), bodies, time)


def read_bodies(solver: InPlaceSolver) -> tuple[BodyState, ...]:
    """Return copies of the bodies' states."""
    return tuple(BodyState(*(value.clone() for value in body)) for body in solver.bodies)


def start_solver(
    config: FlowConfig | Sequence[FlowConfig],
    position: Tensor | None = None,
    heading: Tensor | None = None,
    *,
    velocity: tuple[float, float] = (0.0, 0.0),
    **settings: Any,
) -> InPlaceSolver:
    """Return an eager solver in this process, by default, after a reset of all its flows.

    With positions ``[B, ...]`` it has as many flows.
    """
    num_envs = None if position is None else len(position)
    defaults = {"compile": False, "num_workers": 0, "num_envs": num_envs}
    solver = InPlaceSolver(config=config, **defaults | settings)
    every = torch.ones(solver.num_envs, dtype=torch.bool, device=solver.device)
    solver.reset_(every, position, heading, velocity=velocity)
    return solver
