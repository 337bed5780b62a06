"""Whichever way a body is commanded, its surface moves no faster than the method allows."""

import math
from collections.abc import Callable
from itertools import product
from math import inf, pi

import pytest
import torch

from fishrl.physics import (
    Bending,
    BodyConfig,
    Cylinder,
    Fish,
    FlowConfig,
    FlowState,
    Foil,
    InPlaceSolver,
    Oscillating,
    simulate,
)
from fishrl.physics.flow import make_rest
from tests.physics.flows import place_body

STEPS = 20
FISH = Fish(body_length=24)
BENT = Fish(body_length=24, motion=Bending(gain=0.5, response=3.0))
SWAYING = Cylinder(diameter=10, motion=Oscillating(sway=(3.0, 4.0)))
PITCHING = Foil(chord=16, motion=Oscillating(pitch=0.5, pivot=8.0))
#: Largest value of each quantity, for a surface of 0.3 nodes per step: the tail beats at 0.125 L; a
#: turn is twice as fast as on average, about the middle; the bend begins at response / command.
LIMITS = {
    FISH: {"frequency": 0.3 / (2 * pi * 0.125 * 24), "turn": 0.3 * STEPS / 24, "amplitude": 1.0},
    BENT: {
        "frequency": 0.3 / (2 * pi * 0.125 * 24),
        "turn": 0.3 * STEPS / (3.0 * 0.5 * 24),
        "amplitude": 1.0,
    },
    SWAYING: {"frequency": 0.3 / (2 * pi * 5.0), "turn": inf},
    PITCHING: {"frequency": 0.3 / (2 * pi * 0.5 * 16), "turn": inf},
}


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


@pytest.mark.parametrize(
    ("way", "name"),
    [(construct, "frequency"), *product((command, control), ("frequency", "turn", "amplitude"))],
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
