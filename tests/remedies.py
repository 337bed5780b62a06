"""Calls that are refused, each with the setting that the error names and a value that helps."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import torch

from fishrl.benchmark import identify
from fishrl.envs import Follower, KarmanGait, Oracle, make_task
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.control import Bend, MacroActions, Steady, Turn
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.mirror import join_mirrors
from fishrl.envs.sense import Sense
from fishrl.envs.steering import PIDSteering, PolicySteering
from fishrl.envs.streams import Stream
from fishrl.physics import (
    C_START,
    BounceBack,
    Boundaries,
    Cylinder,
    Fish,
    FlowConfig,
    FlowState,
    Free,
    ImmersedBoundary,
    InPlaceSolver,
    NonEquilibrium,
    Sponge,
    compute_spectral_frequency,
    measure_cycles,
    simulate,
)
from fishrl.physics.bodies.motion import Bending, Commanded, Driven
from fishrl.physics.cache_key import hash_sources
from fishrl.physics.flow import make_params
from fishrl.physics.levels.grids import make_patches
from fishrl.physics.levels.patch import Patch
from fishrl.physics.step import step
from tests.envs.test_mirror import IN_STREAM, MIRRORED
from tests.envs.test_refusals import BENDING, ONCE_PER_T, ROWS, behind, food, gait, pair
from tests.physics.flows import place_body, start_solver, start_stream
from tests.physics.test_refusals import FAST, STEEP, TIGHT, fish, flow

#: In place of a value: the setting is left out.
OUT: Any = object()
#: A call, the setting that its error names, a value with which it fails, and one that helps.
Case = tuple[Callable[..., Any], str, Any, Any]
BALL, BALLS = Cylinder(diameter=20), (Cylinder(diameter=20),) * 2
LEVELS = {"width": 193, "height": 129, "bodies": (Cylinder(diameter=9),), "levels": 2}
NEAR = LEVELS | {"bodies": (Cylinder(diameter=9),) * 2}
TWO = (Patch(bodies=(0,)), Patch(bodies=(1,)))
WAVE = torch.sin(0.1 * torch.arange(500, dtype=torch.float64))
SMALLEST = flow(width=32, height=24)


def body(*, skin: Any = None, **given: Any) -> FlowConfig:
    """Make a flow with one cylinder."""
    return flow(bodies=(Cylinder(**{"diameter": 20} | given),), skin=skin or BounceBack())


def solver(**given: Any) -> InPlaceSolver:
    return start_solver(**{"config": flow(bodies=(BALL,))} | given)


def at(*places: tuple[float, float]) -> torch.Tensor:
    """Return positions of the bodies of one flow."""
    return torch.tensor([places])


ONE, APART, NEARBY = torch.ones(1), at((30.0, 30.0), (90.0, 30.0)), at((80.0, 64.0), (100.0, 64.0))


def spin(speed: float) -> Driven:
    return Driven(angular_velocity=speed)


def run(config: FlowConfig = SMALLEST, **given: Any) -> Any:
    """Take two readable steps of a flow."""
    return simulate(**{"state": start_stream(config), "config": config, "num_steps": 2} | given)


def step_on_levels(has_patches: bool) -> None:
    config = flow(**LEVELS)
    state, params = start_stream(config, place_body(96.0, 64.0)), make_params([config])
    step(make_patches(state, config, params) if has_patches else state, config)


def advance(**given: Any) -> None:
    """Advance two bodies that were placed, or not."""
    two = InPlaceSolver(config=flow(bodies=BALLS), compile=False)
    if given:
        two.reset_(torch.ones(1, dtype=torch.bool), **given)
    two.advance_(2)


FLOWS: list[Case] = [
    (lambda velocity: Boundaries(left=NonEquilibrium(velocity=velocity)), "velocity", None, (1, 0)),
    (lambda name: hash_sources(name), "name", "nothing.such", "fishrl.envs"),
    (lambda samples: compute_spectral_frequency(WAVE[:samples], 1.0), "samples", 3, 4),
    (lambda samples: measure_cycles(WAVE[:samples], 1.0), "samples", 90, 400),
    (solver, "num_envs", 0, 1),
    (partial(solver, config=[SMALLEST] * 2), "num_envs", 3, 2),
    (lambda turn: solver().command_(turn, 2), "turn", 0.1, torch.tensor([0.1])),
    (lambda turn: solver().command_(turn, 2), "turn", torch.ones(3), torch.ones(1)),
    (lambda turn: solver().command_(turn, 2), "turn", ONE * math.nan, ONE),
    (
        lambda speed: solver().set_stream_speed_(speed, num_steps=2),
        "speed",
        ONE.expand(2),
        0.1 * ONE,
    ),
    (
        lambda velocity: start_solver(replace(SMALLEST, stream_speed=0.1), velocity=velocity),
        "velocity",
        (9.0, 0.0),
        (3.0, 0.0),
    ),
    (
        lambda populations: solver().set_populations_([solver().populations()] * populations),
        "populations",
        2,
        1,
    ),
    (solver, "device", "cuda:99", "cpu"),
    (
        lambda patches: start_solver(flow(**NEAR, patches=patches), NEARBY),
        "patches",
        TWO,
        (Patch(bodies=(0, 1), size=(97, 97)),),
    ),
    (lambda bodies: solver(config=flow(bodies=bodies)).body, "bodies", (), (BALL,)),
    (lambda num_steps: solver().advance_(num_steps), "num_steps", 3, 4),
    (lambda num_steps: solver().command_(torch.ones(1), num_steps), "num_steps", 1, 2),
    (lambda bodies: solver(config=flow(bodies=bodies)).markers(0), "bodies", (), (BALL,)),
    (advance, "position", OUT, APART),
    (
        lambda move: flow(**LEVELS, patches=(Patch(), Patch(bodies=(), size=(9, 9), centre=move))),
        "move",
        (2.0, 2.0),
        (40.0, 40.0),
    ),
    (
        lambda skin: flow(bodies=flow(bodies=(BALL,)).bodies, skin=skin),
        "skin",
        ImmersedBoundary(),
        BounceBack(),
    ),
    (lambda make_patches: step_on_levels(make_patches), "make_patches", False, True),
    (flow, "bodies", (Cylinder(diameter=9), Fish(body_length=24)), (Fish(body_length=24),)),
    (partial(flow, boundaries=FAST), "stream_speed", 1.0, 0.5),
    (lambda Sponge: flow(sponges=(Sponge,)), "Sponge", Sponge(length=129), Sponge(length=100)),
    (lambda body: flow(bodies=(Cylinder(diameter=body),)), "body", 70, 50),
    (
        partial(flow, **LEVELS),
        "patches",
        (Patch(bodies=(), size=(9, 9), centre=(50.0, 50.0)),),
        (Patch(bodies=(0,)),),
    ),
    (partial(flow, **LEVELS), "width", 192, 193),
    (partial(flow, **LEVELS | {"width": 65, "height": 49}), "levels", 4, 1),
    (partial(Patch, centre=(9.0, 9.0)), "within", ((0.0, 0.0), (9.0, 9.0)), OUT),
    (partial(Patch, bodies=(), size=(9, 9)), "centre", OUT, (9.0, 9.0)),
    (lambda position: solver().reset_(ONE > 0, position), "position", 1, at((60.0, 30.0))),
    (
        lambda position: start_solver(flow(bodies=(BALL,)), position, num_envs=1),
        "position",
        at((60.0, 30.0), (60.0, 40.0)),
        at((60.0, 30.0)),
    ),
    (run, "num_steps", 0, 2),
    (
        lambda f: run(state=FlowState(start_stream(SMALLEST).f.to(f), ())),
        "f",
        torch.half,
        torch.float,
    ),
    (
        lambda compile: torch.func.vmap(lambda x: run(compile=compile)[0].f * x)(torch.ones(1)),
        "compile",
        True,
        False,
    ),
    (partial(body, skin=BounceBack()), "inset", 0.4, OUT),
    (body, "num_markers", 20, OUT),
    (partial(body, diameter=16, density_ratio=0.7, motion=Free()), "skin", ImmersedBoundary(), OUT),
    (lambda bodies: step(start_stream(flow()), flow(bodies=bodies)), "bodies", (BALL,), ()),
    (fish, "num_markers", 101, 102),
    (
        lambda amplitude: fish(gait=replace(STEEP, amplitude=amplitude), keeps_length=True),
        "amplitude",
        0.2,
        0.1,
    ),
    (fish, "strokes", TIGHT, C_START),
    (partial(fish, keeps_length=True), "motion", Bending(), Commanded()),
    (lambda motion: Cylinder(diameter=40, motion=motion), "motion", spin(0.02), spin(0.01)),
    (Driven, "velocity", (0.3, 0.3), (0.2, 0.2)),
]


def check_starts(**changes: Any) -> None:
    """Check the starts that a task samples, some of them changed."""
    TASK.check_starts(STARTS.clone().update(changes))


TASK, DISC = food(), behind()
STARTS = TASK.sample_starts(2, torch.Generator().manual_seed(0))
FOOD = TASK.locate_food(STARTS, torch.zeros(2))
ENVS: list[Case] = [
    (partial(LateralLine, is_averaged=True), "features", OUT, ("p",)),
    (Follower, "start_x_bl", (0.5, 1.5), (1.0, 1.5)),
    (lambda **changed: identify(make_task("station-v0", **changed)), "reynolds", 401.0, OUT),
    (
        lambda mirrored_actions: mirrored_actions.fget(Turn()),
        "mirrored_actions",
        Steady.mirrored_actions,
        Turn.mirrored_actions,
    ),
    (partial(gait, **ONCE_PER_T), "control", BENDING, replace(BENDING, bend_bl=0.1)),
    (
        lambda rows: gait(
            stream=Stream(speeds_bl=(1.0,)), start_flows=(0,), control=MacroActions(rows=rows)
        ),
        "rows",
        ROWS,
        ROWS[:1],
    ),
    (MacroActions, "rows", ((1.0, 2.0), (1.0, 2.0, 3.0)), ((1.0, 2.0), (1.0, 3.0))),
    (Bend, "beat", Turn(), Steady()),
    (lambda mirror: join_mirrors([Sense("x", ("x",), abs, mirror)]), "mirror", None, (1,)),
    (lambda mirror: join_mirrors([Sense("x", ("x",), abs, mirror)]), "mirror", (2,), (1,)),
    (lambda task: Oracle().check(task), "task", TASK, DISC),
    (lambda shape: TASK.check_starts(STARTS[shape]), "shape", 0, torch.tensor([0, 1])),
    (check_starts, "other", torch.zeros(2), OUT),
    (check_starts, "head", torch.zeros(2, 2, dtype=torch.float64), OUT),
    (check_starts, "head", torch.zeros(2, 2), OUT),
    (gait, "start_x_bl", (0.3, 1.0), (1.5, 2.0)),
    (behind, "diameter_bl", (0.4, 0.5), (0.4, 0.5, 0.4)),
    (partial(behind, diameter_bl=(0.4, 0.6, 0.4)), "face_bl", 0.3, 2.5),
    (
        lambda speeds: behind(changes=StreamSwitches(speeds_bl=speeds)),
        "speeds",
        (1.0, 3.0),
        (1.0, 1.2),
    ),
    (Follower, "control", Bend(), OUT),
    (Follower, "start_x_bl", (1.5, 1.0), (1.0, 1.5)),
    (partial(food, food_x_bl=0.9), "food_tilt_degrees", (0.0, 80.0), (0.0, 10.0)),
    (gait, "observes", ("flow_label",), ("place",)),
    (gait, "start_flows", (), (0, 1)),
    (
        lambda decisions_per_T: gait(
            steering=PolicySteering(decisions_per_T=decisions_per_T), **ONCE_PER_T
        ),
        "decisions_per_T",
        4,
        1,
    ),
    (
        lambda steering: KarmanGait(**IN_STREAM, steering=steering).mirror,
        "steering",
        PolicySteering(),
        PIDSteering(),
    ),
    (lambda start_x_bl: food(start_x_bl=start_x_bl), "start_x_bl", (9.9, 9.9), (5.0, 9.9)),
    (food, "start_x_bl", (2.0, 7.5), (4.5, 7.5)),
    (lambda away: check_starts(head=FOOD.double() + away), "away", 0.0, 30.0),
    (
        lambda food_direction: food(**MIRRORED | {"food_direction": food_direction}).mirror,
        "food_direction",
        "up",
        "random",
    ),
    (pair, "contact_bl", 0.04, 0.05),
    (partial(pair, start_gap_bl=0.9), "contact_bl", 0.85, 0.5),
]
