"""Calls that are refused, each with the setting that the error names and a value that helps."""

import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import torch

from fishrl.benchmark import identify
from fishrl.envs import Follower, KarmanGait, Oracle, Predation, PredationPair, make_task
from fishrl.envs.changes import StreamSwitches
from fishrl.envs.control import Bend, ContinuousFrequency, MacroActions, Steady, Turn
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
    Foil,
    Free,
    Gait,
    ImmersedBoundary,
    InPlaceSolver,
    NonEquilibrium,
    OpenEdge,
    Periodic,
    Scales,
    Sponge,
    Strokes,
    compute_spectral_frequency,
    compute_tau,
    measure_cycles,
    simulate,
)
from fishrl.physics.bodies.motion import Bending, Commanded, Driven
from fishrl.physics.boundaries import Side
from fishrl.physics.cache_key import hash_sources
from fishrl.physics.collision import Rates
from fishrl.physics.flow import make_params
from fishrl.physics.levels.grids import make_patches as refine
from fishrl.physics.levels.patch import Patch
from fishrl.physics.skins import IterativeForcing
from fishrl.physics.step import step
from tests.envs.conftest import SMALL
from tests.envs.test_mirror import IN_STREAM, MIRRORED
from tests.physics.flows import place_body, start_solver, start_stream

#: In place of a value: the setting is left out.
OUT: Any = object()
#: A call, the setting that its error names, a value with which it fails, and one that helps.
Case = tuple[Callable[..., Any], str, Any, Any]


def complete(cases: Iterable[tuple[Any, ...]]) -> list[Case]:
    """Let the setting be the argument of the call where none is named."""
    return [
        (make, names[0] if names else next(iter(inspect.signature(make).parameters)), bad, good)
        for make, *names, bad, good in cases
    ]


scale = partial(Scales, body_length=100, reynolds=7000.0)
flow = partial(FlowConfig, width=128, height=64, tau=0.6)
fish = partial(Fish, body_length=50)
BALL, BALLS = Cylinder(diameter=20), (Cylinder(diameter=20),) * 2
FAST = Boundaries(left=NonEquilibrium(velocity=(0.5, 0.0)), right=OpenEdge())
STEEP = Gait(amplitude=0.2, envelope=(0.0, 1.0, 0.0), wavenumber=2 * math.pi)
TIGHT = Strokes(sequence=(replace(C_START.sequence[0], bend=(50.0, 0.0, 0.0)),))
LEVELS = {"width": 193, "height": 129, "bodies": (Cylinder(diameter=9),), "levels": 2}
NEAR = LEVELS | {"bodies": (Cylinder(diameter=9),) * 2}
TWO, BOTH = (Patch(bodies=(0,)), Patch(bodies=(1,))), (Patch(bodies=(0, 1), size=(97, 97)),)
WAVE = torch.sin(0.1 * torch.arange(500, dtype=torch.float64))
SMALLEST = flow(width=32, height=24)


def solver(**given: Any) -> InPlaceSolver:
    return start_solver(**{"config": flow(bodies=(BALL,))} | given)


def turn_by(turn: Any) -> None:
    solver().command_(turn, 2)


def at(*places: tuple[float, float]) -> torch.Tensor:
    """Return positions of the bodies of one flow."""
    return torch.tensor([places])


ONE, APART, NEARBY = torch.ones(1), at((30.0, 30.0), (90.0, 30.0)), at((80.0, 64.0), (100.0, 64.0))
HERE, THERE, SOFT = (60.0, 30.0), (60.0, 40.0), ImmersedBoundary()
STILL, TOP = partial(Patch, bodies=(), size=(9, 9)), partial(Sponge, side=Side.TOP)


def spin(speed: float) -> Driven:
    return Driven(angular_velocity=speed)


def run(config: FlowConfig = SMALLEST, **given: Any) -> Any:
    """Take two readable steps of a flow."""
    return simulate(**{"state": start_stream(config), "config": config, "num_steps": 2} | given)


def step_on_levels(make_patches: bool) -> None:
    config = flow(**LEVELS)
    state, params = start_stream(config, place_body(96.0, 64.0)), make_params([config])
    step(refine(state, config, params) if make_patches else state, config)


def advance(**given: Any) -> None:
    """Advance two bodies that were placed, or not."""
    two = InPlaceSolver(config=flow(bodies=BALLS), compile=False)
    if given:
        two.reset_(torch.ones(1, dtype=torch.bool), **given)
    two.advance_(2)


def lay_markers(**given: Any) -> None:
    flow(bodies=(Cylinder(diameter=20, **given),))


LIGHT = Cylinder(diameter=16, density_ratio=0.7, motion=Free())


def go_through(compile: bool) -> None:
    torch.func.vmap(lambda x: run(compile=compile)[0].f * x)(torch.ones(1))


FLOWS: list[tuple[Any, ...]] = [
    (lambda velocity: Boundaries(left=NonEquilibrium(velocity=velocity)), None, (1, 0)),
    (lambda name: hash_sources(name), "nothing.such", "fishrl.envs"),
    (flow, "tau", 0.5, 0.55),
    (flow, "tau", 3.0, 1.5),
    (partial(flow, boundaries=FAST), "stream_speed", 0.9, 0.2),
    (
        partial(flow, stream_speed=0.1),
        "boundaries",
        Boundaries(left=NonEquilibrium(velocity=(1.0, 0.0))),
        FAST,
    ),
    (partial(compute_tau, length=24.0, speed=0.07), "reynolds", 20000.0, 1000.0),
    (partial(compute_tau, speed=0.1, reynolds=1.0), "length", 24.0, 2.0),
    (partial(Scales, body_length=100, reynolds=7000.0), "period", 400, 800),
    (partial(Scales, body_length=100, period=600), "reynolds", 1e6, 1e4),
    (partial(Scales.from_budget, body_length=24), "reynolds", 1e5, 1e3),
    (lay_markers, "inset", 0.4, OUT),
    (lay_markers, "num_markers", 20, OUT),
    (lay_markers, "marker_spacing", 1.5, OUT),
    (partial(flow, bodies=(LIGHT,)), "skin", SOFT, BounceBack()),
    (lambda samples: compute_spectral_frequency(WAVE[:samples], 1.0), 3, 4),
    (lambda samples: measure_cycles(WAVE[:samples], 1.0), 90, 400),
    (scale, "period", 601, 602),
    (partial(scale, stream_speed_bl=1.2), "period", 600, 1000),
    (solver, "num_envs", 0, 1),
    (partial(solver, config=[SMALLEST] * 2), "num_envs", 3, 2),
    (lambda batch: solver(config=batch), (flow(), flow(rates=Rates(energy=1.0))), (flow(),) * 2),
    (turn_by, 0.1, torch.tensor([0.1])),
    (lambda points: solver().sample(points), (0.0, 0.0), torch.zeros(1, 1, 2)),
    (turn_by, torch.ones(3), ONE),
    (turn_by, ONE * math.nan, ONE),
    (lambda speed: solver().set_stream_speed_(speed, num_steps=2), ONE.expand(2), 0.1 * ONE),
    (partial(start_solver, replace(SMALLEST, stream_speed=0.1)), "velocity", (9.0, 0), (3.0, 0)),
    (lambda populations: solver().set_populations_([solver().populations()] * populations), 2, 1),
    (solver, "device", "cuda:99", "cpu"),
    (lambda patches: start_solver(flow(**NEAR, patches=patches), NEARBY), TWO, BOTH),
    (lambda bodies: solver(config=flow(bodies=bodies)).body, (), (BALL,)),
    (lambda num_steps: solver().advance_(num_steps), 3, 4),
    (lambda num_steps: solver().command_(torch.ones(1), num_steps), 1, 2),
    (lambda bodies: solver(config=flow(bodies=bodies)).markers(0), (), (BALL,)),
    (advance, "position", OUT, APART),
    (lambda move: flow(**LEVELS, patches=(Patch(), STILL(centre=move))), (2.0, 2.0), (40.0, 40.0)),
    (lambda skin: flow(bodies=flow(bodies=(BALL,)).bodies, skin=skin), SOFT, BounceBack()),
    (step_on_levels, False, True),
    (flow, "bodies", (Cylinder(diameter=9), Fish(body_length=24)), (Fish(body_length=24),)),
    (lambda left: Boundaries(left=left), Periodic(), FAST.left),
    (lambda Sponge: flow(sponges=(Sponge,)), TOP(length=65), TOP(length=60)),
    (lambda body: flow(bodies=(Cylinder(diameter=body),)), 70, 50),
    (partial(flow, **LEVELS), "patches", (STILL(centre=(50.0, 50.0)),), (Patch(bodies=(0,)),)),
    (partial(flow, **LEVELS), "bodies", (), (BALL,)),
    (partial(flow, **LEVELS), "width", 192, 193),
    (partial(flow, **LEVELS | {"width": 65, "height": 49}), "levels", 4, 1),
    (partial(Patch, centre=(9.0, 9.0)), "within", ((0.0, 0.0), (9.0, 9.0)), OUT),
    (partial(Patch, bodies=(), size=(9, 9)), "centre", OUT, (9.0, 9.0)),
    (partial(STILL, centre=(9.0, 9.0)), "size", (7.0, 20.0), (8.0, 20.0)),
    (lambda position: solver().reset_(ONE > 0, position), 1, at(HERE)),
    (
        lambda position: start_solver(flow(bodies=(BALL,)), position, num_envs=1),
        at(HERE, THERE),
        at(HERE),
    ),
    (run, "num_steps", 0, 2),
    (lambda f: run(state=FlowState(start_stream(SMALLEST).f.to(f), ())), torch.half, torch.float),
    (go_through, True, False),
    (IterativeForcing, "relaxation", 2.0, 1.9),
    (lambda bodies: step(start_stream(flow()), flow(bodies=bodies)), (BALL,), ()),
    (fish, "num_markers", 101, 102),
    (lambda amplitude: fish(gait=replace(STEEP, amplitude=amplitude), keeps_length=True), 0.2, 0.1),
    (Strokes, "sequence", (), C_START.sequence),
    (fish, "strokes", TIGHT, C_START),
    (partial(fish, keeps_length=True), "motion", Bending(), Commanded()),
    (partial(Cylinder, diameter=20), "motion", Bending(), Commanded()),
    (lambda motion: Cylinder(diameter=40, motion=motion), spin(0.02), spin(0.01)),
    (Driven, "velocity", (0.3, 0.3), (0.2, 0.2)),
    (lambda Foil: Foil(chord=20), partial(Foil, thickness=0.04), Foil),
]


ROWS = ((0.5, 1.0, 1.5), (0.6, 1.1, 1.6), (0.7, 1.2, 1.7))
ONCE_PER_T = {"control_interval_T": 1.0, "checks_per_action": 25}
BENDING = Bend(beat=MacroActions(rows=ROWS), bend_bl=0.5, response_T=0.2)
food, pair = partial(Predation, **SMALL), partial(PredationPair, **SMALL)
gait = partial(KarmanGait, **SMALL | {"wall_margin_bl": 0.25, "control": MacroActions(rows=ROWS)})
ON_LEVELS = {"body_length": 16, "reynolds": 400.0, "wall_margin_bl": 0.7, "checks_per_action": 20}


def behind(**disc: Any) -> KarmanGait:
    return gait(stream=Stream(**disc))


def on_levels(**changes: Any) -> Predation:
    return Predation(levels=2, **ON_LEVELS | changes)


def switch(speeds_bl: tuple[float, ...]) -> KarmanGait:
    return behind(changes=StreamSwitches(speeds_bl=speeds_bl))


def gait_in_one_flow(rows: Any) -> KarmanGait:
    one = Stream(speeds_bl=(1.0,))
    return gait(stream=one, start_flows=(0,), control=MacroActions(rows=rows))


def steer(decisions_per_T: int) -> KarmanGait:
    return gait(steering=PolicySteering(decisions_per_T=decisions_per_T), **ONCE_PER_T)


def hunt(food_direction: Any) -> Predation:
    return Predation(**MIRRORED | {"food_direction": food_direction})


def check_starts(**changes: Any) -> None:
    """Check the starts that a task samples, some of them changed."""
    TASK.check_starts(STARTS.clone().update(changes))


TASK, DISC = food(), behind()
STARTS = TASK.sample_starts(2, torch.Generator().manual_seed(0))
FOOD, NONE = TASK.locate_food(STARTS, torch.zeros(2)), torch.zeros(2, dtype=torch.float64)
FROZEN, STEERED, PID = "station-v1", [of.mirrored_actions for of in (Steady, Turn)], PIDSteering()
ENVS: list[tuple[Any, ...]] = [
    (partial(Predation, control=Bend(), levels=1), "wall_margin_bl", 0.01, 0.2),
    (lambda response_T: Predation(control=Bend(response_T=response_T)), 0.05, 0.2),
    (Predation, "reynolds", 1e5, 1e3),
    (partial(Predation, control=Turn(turn_degrees=170.0)), "max_wall_speed", 0.15, 0.07),
    (Predation, "start_x_bl", (9.5, 9.6), (4.5, 7.5)),
    (PredationPair, "start_gap_bl", 4.5, 1.0),
    (StreamSwitches, "interval_T", 0.9, 2.0),
    (food, "food_limits_bl", (3.5, 1.5), (1.5, 3.5)),
    (food, "food_speed_bl", (0.5, 0.2), (0.2, 0.5)),
    (food, "turn_degrees", 10.0, OUT),
    (food, "coupling", "implicit", OUT),
    (food, "critic_observes", ("plaice",), ("place_of_the_food",)),
    (gait, "critic_observes", ("plaice",), ("place",)),
    (lambda edges: Follower(leader_x_bl=edges), 1.0, 3.0),
    (on_levels, "checks_per_action", 200, 40),
    (partial(gait, lateral_line=LateralLine(num_samples=20)), "checks_per_action", 1, 25),
    (partial(food, checks_per_action=53), "wall_margin_bl", 0.081, 0.15),
    (lambda domain: on_levels(domain_bl=(10.0, domain)), 3.0, 5.0),
    (behind, "speeds_bl", (1.0, 1.0, 1.1), (1.0, 1.1, 1.2)),
    (lambda diameter: behind(diameter_bl=(0.4, 0.4, diameter)), 0.3, 0.5),
    (StreamSwitches, "speeds_bl", (1.0, 1.0), (1.0, 1.1)),
    (LateralLine, "first_bl", 0.8, 0.6),
    (LateralLine, "delay", 9, 2),
    (MacroActions, "rows", ((2.0, 1.0),), ((1.0, 2.0),)),
    (partial(MacroActions, rows=ROWS), "first_gear", 4, 2),
    (ContinuousFrequency, "frequency_range", (2.0, 1.0), (1.0, 2.0)),
    (partial(LateralLine, is_averaged=True), "features", OUT, ("p",)),
    (Follower, "start_x_bl", (0.5, 1.5), (1.0, 1.5)),
    (lambda **changed: identify(make_task(FROZEN, **changed)), "reynolds", 401.0, OUT),
    (lambda mirrored_actions: mirrored_actions.fget(Turn()), *STEERED),
    (partial(gait, **ONCE_PER_T), "control", BENDING, replace(BENDING, bend_bl=0.1)),
    (gait_in_one_flow, ROWS, ROWS[:1]),
    (MacroActions, "rows", ((1.0, 2.0), (1.0, 2.0, 3.0)), ((1.0, 2.0), (1.0, 3.0))),
    (Bend, "beat", Turn(), Steady()),
    (lambda mirror: join_mirrors([Sense("x", ("x",), abs, mirror)]), None, (1,)),
    (lambda mirror: join_mirrors([Sense("x", ("x",), abs, mirror)]), (2,), (1,)),
    (lambda task: Oracle().check(task), TASK, DISC),
    (lambda shape: TASK.check_starts(STARTS[shape]), 0, torch.tensor([0, 1])),
    (check_starts, "other", torch.zeros(2), OUT),
    (check_starts, "food_direction", NONE + 0.5, NONE + 1.0),
    (check_starts, "head", torch.zeros(2, 2, dtype=torch.float64), OUT),
    (check_starts, "head", torch.zeros(2, 2), OUT),
    (gait, "start_x_bl", (0.3, 1.0), (1.5, 2.0)),
    (behind, "diameter_bl", (0.4, 0.5), (0.4, 0.5, 0.4)),
    (partial(behind, diameter_bl=(0.4, 0.6, 0.4)), "face_bl", 0.3, 2.5),
    (switch, (1.0, 3.0), (1.0, 1.2)),
    (Follower, "control", Bend(), OUT),
    (Follower, "start_x_bl", (1.5, 1.0), (1.0, 1.5)),
    (partial(food, food_x_bl=0.9), "food_tilt_degrees", (0.0, 80.0), (0.0, 10.0)),
    (gait, "observes", ("flow_label",), ("place",)),
    (gait, "start_flows", (), (0, 1)),
    (steer, 4, 1),
    (PolicySteering, "weights", "others", OUT),
    (lambda steering: gait(steering=steering), PIDSteering(max_turn_degrees=90.0), PID),
    (lambda steering: KarmanGait(**IN_STREAM, steering=steering).mirror, PolicySteering(), PID),
    (food, "start_x_bl", (2.0, 7.5), (4.5, 7.5)),
    (lambda away: check_starts(head=FOOD.double() + away), 0.0, 30.0),
    (lambda food_direction: hunt(food_direction).mirror, "up", "random"),
    (pair, "contact_bl", 0.04, 0.05),
    (partial(pair, start_gap_bl=0.9), "contact_bl", 0.85, 0.5),
]
