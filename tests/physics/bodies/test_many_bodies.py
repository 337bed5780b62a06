"""Several bodies in one flow, and flows that differ within one batch."""

import math

import pytest
import torch

from fishrl.physics import Cylinder, DCylinder, Ellipse, Fish, FlowConfig, InPlaceSolver
from fishrl.physics.bodies.gait import Gait
from fishrl.physics.bodies.motion import Fixed, Free, Oscillating
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, NoSlip, Profile
from fishrl.physics.flow import make_params
from fishrl.physics.skins import ImmersedBoundary
from tests.physics.flows import advance, read_state, start_solver

CHANNEL = Boundaries(
    left=NonEquilibrium(velocity=(1.0, 0.0), profile=Profile.PARABOLA),
    right=NonEquilibrium(density=1.0),
    bottom=NoSlip(),
    top=NoSlip(),
)

KICKED = Fixed(kick_speed=0.01, kick_steps=30)


def make_crowd(tau: float = 0.56, diameter: float = 12.0, amplitude: float = 0.1) -> FlowConfig:
    """A fish, an oscillating ellipse, a kicked half disc and a heavy free disc in a channel."""
    gait = Gait(amplitude=amplitude, envelope=(0.03, 1.0, 0.0), wavenumber=6.0)
    return FlowConfig(
        width=120,
        height=72,
        tau=tau,
        stream_speed=0.1 * tau,
        ramp_steps=100,
        bodies=(
            Fish(body_length=24, gait=gait),
            Ellipse(length=10, width=8, motion=Oscillating(sway=(0.5, 2.0), pitch=0.2)),
            DCylinder(diameter=diameter, num_markers=36, motion=KICKED),
            Cylinder(diameter=9, density_ratio=1.5, motion=Free()),
        ),
        boundaries=CHANNEL,
        skin=ImmersedBoundary(),
    )


def start_crowd(configs: list[FlowConfig], **settings: object) -> InPlaceSolver:
    places = torch.tensor([[70.0, 36.4], [95.3, 20.1], [24.4, 34.2], [95.0, 50.3]])
    headings, num = torch.tensor([math.pi, 0.3, math.pi, 0.0]), len(configs)
    where = places.expand(num, 4, 2), headings.expand(num, 4)
    frequency = torch.tensor([1 / 200, 1 / 260])[:num]
    solver = start_solver(configs, *where, frequency=frequency, **settings)
    solver.bodies[3].load[:, 1] = -0.002
    return solver


CROWD = [make_crowd(), make_crowd(tau=0.6, diameter=15.0, amplitude=0.07)]


@pytest.mark.parametrize(
    "compile", [False, pytest.param(True, marks=[pytest.mark.compile, pytest.mark.slow])]
)
def test_many_bodies_in_flows_that_differ_equal_the_readable_step(compile: bool) -> None:
    solver = start_crowd(CROWD, flows_per_launch=2, compile=compile)
    start = read_state(solver)
    solver.advance_(120)
    state = advance(start, CROWD[0], 120, make_params(CROWD))
    scale = float(state.f.abs().max())
    assert float((solver.populations() - state.f).abs().max()) < 1e-5 * scale
    for got, expected in zip(solver.bodies, state.bodies, strict=True):
        torch.testing.assert_close(got.position, expected.position, rtol=0, atol=1e-5)
        torch.testing.assert_close(got.impulse, expected.impulse, rtol=1e-3, atol=1e-5)
    still = solver.bodies[2]
    assert torch.equal(still.position, start.bodies[2].position)
    sunk = start.bodies[3].position - solver.bodies[3].position
    assert (sunk[:, 1] > 0.05).all()
    assert (still.impulse[:, 0] > 0.1).all()  # drag


def test_each_fish_turns_and_beats_as_it_is_commanded() -> None:
    config = FlowConfig(width=64, height=72, tau=0.6, bodies=(Fish(body_length=16),) * 3)
    places = torch.tensor([[[32.0, 18.0], [32.0, 36.0], [32.0, 54.0]]])
    solver = start_solver(config, places, torch.zeros(1, 3), frequency=1 / 160)
    backwards = -1 / 320  # a wave that rises as one that runs forwards
    solver.command_(torch.tensor([[0.5, -0.5]]), 80, torch.tensor([[1 / 160, backwards]]))
    solver.advance_(80)
    turned = torch.cat([body.heading + body.internal_angle for body in solver.bodies])
    beats = torch.cat([body.beats for body in solver.bodies])
    assert turned[0] > turned[2] + 0.2 and turned[1] < turned[2] - 0.2
    torch.testing.assert_close(beats, torch.tensor([0.5, 0.25, 0.5]).double())
