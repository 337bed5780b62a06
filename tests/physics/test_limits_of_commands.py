"""Whichever way a body is commanded, its surface moves no faster than the method allows."""

import math
from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from itertools import product
from math import inf, pi

import pytest
import torch
from torch.utils import _pytree as pytree

from fishrl.physics import (
    Bending,
    BodyConfig,
    Cylinder,
    Driven,
    Fish,
    Fixed,
    FlowConfig,
    FlowState,
    Foil,
    Free,
    InPlaceSolver,
    Oscillating,
    Surging,
    Towed,
    simulate,
)
from fishrl.physics.bodies import motion
from fishrl.physics.bodies.motion import Motion
from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.flow import make_params, make_rest
from tests.physics.flows import place_body

STEPS = 20
FISH = Fish(body_length=24)
BENT = Fish(body_length=24, motion=Bending(gain=0.5, response=3.0))
SLIDING = Fish(body_length=24, keeps_length=True)
SWAYING = Cylinder(diameter=10, motion=Oscillating(sway=(3.0, 4.0)))
SURGING = Cylinder(diameter=10, motion=Surging(sway=(0.0, 4.0)))
PITCHING = Foil(chord=16, motion=Oscillating(pitch=0.5, pivot=8.0))
LOOSE, HELD = Fish(body_length=24, motion=Free()), Fish(body_length=24, motion=Fixed())
DRIVEN = Fish(body_length=24, motion=Driven(velocity=(0.0, 0.1)))
BEAT = 0.3 / (2 * pi * 0.125 * 24)
#: Largest value of each quantity, for a surface of 0.3 nodes per step: the tail beats at 0.125 L; a
#: turn is twice as fast as on average, about the middle; the bend begins at response / command.
LIMITS = {
    FISH: {"frequency": BEAT, "turn": 0.3 * STEPS / 24, "amplitude": 1.0},
    BENT: {"frequency": BEAT, "turn": 0.3 * STEPS / (3.0 * 0.5 * 24), "amplitude": 1.0},
    LOOSE: {"frequency": BEAT, "turn": inf, "amplitude": 1.0},
    HELD: {"frequency": BEAT, "turn": inf, "amplitude": 1.0},
    DRIVEN: {"frequency": BEAT * 2 / 3, "turn": inf, "amplitude": 1.0},
    SWAYING: {"frequency": 0.3 / (2 * pi * 5.0), "turn": inf},
    SURGING: {"frequency": 0.3 / (2 * pi * 4.0), "turn": inf},
    SLIDING: {"frequency": BEAT, "turn": 0.3 * STEPS / 24, "amplitude": 1.0},
    PITCHING: {"frequency": 0.3 / (2 * pi * 0.5 * 16), "turn": inf},
}


def find_near(body: BodyConfig) -> float:
    """Return a frequency near its bound."""
    at_rest, beating = body.compute_wall_speed(0.0), body.compute_wall_speed(1.0)
    return 0.9 * (0.3 - at_rest) / (beating - at_rest)


def construct(config: FlowConfig, name: str, value: float) -> None:
    assert name == "frequency"  # the others are given with a command alone
    InPlaceSolver(config=config, num_envs=1, frequency=value, compile=False)


def command(config: FlowConfig, name: str, value: float) -> None:
    """Command one of two flows; what is refused leaves both as they were."""
    solver = InPlaceSolver(config=config, num_envs=2, compile=False)
    before = solver.state_dict()
    order = torch.tensor([0.0, value], dtype=torch.float64)
    try:
        solver.command_(**{"turn": torch.zeros(2), "num_steps": STEPS} | {name: order})
    except ValueError:
        assert all(torch.equal(old, before[key]) for key, old in solver.state_dict().items())
        raise


def control(config: FlowConfig, name: str, value: float) -> None:
    """Change the body between two intervals of readable steps."""
    field = {"amplitude": "amplitude_goal"}.get(name, name)
    order = {field: value, "turn_steps": float(STEPS), "turn_clock": 0.0}

    def change(number: int, state: FlowState) -> FlowState:
        return state._replace(bodies=(place_body(32.0, 24.0, **order),))

    state = FlowState(make_rest(config, 1), (place_body(32.0, 24.0),))
    simulate(state, config, num_steps=2, control=change)


def write(config: FlowConfig, name: str, value: float) -> None:
    """Write the state of one of two bodies directly."""
    solver = InPlaceSolver(config=config, num_envs=2, frequency=0.0, compile=False)
    solver.advance_(2)
    solver.body.turn_steps[1] = STEPS
    getattr(solver.body, {"amplitude": "amplitude_goal"}.get(name, name))[1] = value
    solver.advance_(2, rows=torch.tensor([False, True]))


def write_state(config: FlowConfig, name: str, value: float) -> None:
    """Write what a command changes by and by."""
    assert name in ("amplitude", "towed")
    solver = InPlaceSolver(config=config, num_envs=1, frequency=0.0, compile=False)
    (solver.body.amplitude if name == "amplitude" else solver.body.velocity[:, 0]).fill_(value)
    solver.advance_(2)


def load(config: FlowConfig, name: str, value: float) -> None:
    """Load a state in which somebody has changed the command."""
    solver = InPlaceSolver(config=config, num_envs=1, frequency=0.0, compile=False)
    state, field = solver.state_dict(), {"amplitude": "amplitude_goal"}.get(name, name)
    state["bodies[0].turn_steps"].fill_(STEPS)
    state[f"bodies[0].{field}"].fill_(value)
    solver.load_state_dict(state)
    solver.advance_(2)


def replace_body(config: FlowConfig, name: str, value: float) -> None:
    """Give one of two flows a body of another size, with ``set_body_``."""
    assert name == "size"
    body = config.bodies[0]
    solver = InPlaceSolver(config=config, num_envs=2, frequency=find_near(body), compile=False)
    two = pytree.tree_map(lambda of: of.expand(2, *of.shape[1:]), enlarge(body, value))
    solver.set_body_(0, two, torch.tensor([False, True]))
    solver.advance_(2)


def give_params(config: FlowConfig, name: str, value: float) -> None:
    """Give readable steps a body of another size, with ``params``."""
    assert name == "size"
    body = config.bodies[0]
    params = make_params([config])._replace(bodies=(enlarge(body, value),))
    state = FlowState(make_rest(config, 1), (place_body(32.0, 24.0, frequency=find_near(body)),))
    simulate(state, config, params, num_steps=2)


def enlarge(body: BodyConfig, factor: float) -> BodyParams:
    name = "body_length" if isinstance(body, Fish) else "chord"
    old = FlowConfig(width=64, height=48, tau=0.6, bodies=(body,)).bodies[0]
    size = int(getattr(body, name) * factor)
    return replace(old, num_markers=old.num_markers, **{name: size}).make_params()


@pytest.mark.parametrize(
    ("way", "name"),
    [
        (construct, "frequency"),
        *product((command, control, write, load), ("frequency", "turn", "amplitude")),
        (write_state, "amplitude"),
    ],
)
@pytest.mark.parametrize("body", LIMITS, ids=lambda body: type(body.motion).__name__)
def test_every_way_of_commanding_a_body_has_the_bound_of_its_constructor(
    way: Callable[[FlowConfig, str, float], None], body: BodyConfig, name: str
) -> None:
    config = FlowConfig(width=64, height=48, tau=0.6, bodies=(body,))
    most = LIMITS[body].get(name, 1.0)
    for sign in (1.0, -1.0):
        way(config, name, 0.999 * sign * min(most, 100.0))
        if math.isinf(most):  # a turn that this motion does not heed
            continue
        with pytest.raises(ValueError, match="allowed is"):
            way(config, name, 1.001 * sign * most)


@pytest.mark.parametrize("way", [replace_body, give_params])
@pytest.mark.parametrize(
    "body", [FISH, BENT, SLIDING, PITCHING], ids=["turned", "bent", "sliding", "pitching"]
)
def test_body_of_another_size_has_the_bound_of_its_own(
    way: Callable[[FlowConfig, str, float], None], body: BodyConfig
) -> None:
    config = FlowConfig(width=64, height=48, tau=0.6, bodies=(body,))
    way(config, "size", 1.0)
    way(config, "size", 0.9)
    with pytest.raises(ValueError, match="allowed is"):
        way(config, "size", 1.4)


def test_towed_fish_has_a_bound_of_its_speed() -> None:
    config = FlowConfig(width=64, height=48, tau=0.6, bodies=(replace(FISH, motion=Towed()),))
    write_state(config, "towed", -0.299)
    with pytest.raises(ValueError, match="allowed is"):
        write_state(config, "towed", -0.301)


def test_every_motion_and_every_way_of_commanding_is_tried() -> None:
    """A new one fails here until it has its limits above."""
    motions = {k for k in vars(motion).values() if isinstance(k, type) and issubclass(k, Motion)}
    assert motions - {Motion} == {Towed, *(type(body.motion) for body in LIMITS)}
    order = {*signature(InPlaceSolver.command_).parameters} - {"self", "num_steps"}
    assert order == set().union(*LIMITS.values())
    changing = {name for name in dir(InPlaceSolver) if name[0] != "_" and name[-1] == "_"}
    of_water = {"join_stream_", "set_stream_speed_", "set_populations_", "reset_"}
    assert changing - of_water == {"advance_", "command_", "set_body_"}
