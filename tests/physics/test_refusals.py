"""Settings of flows and bodies that are refused, with a remedy."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest

from fishrl.physics import (
    C_START,
    Boundaries,
    Cylinder,
    Fish,
    FlowConfig,
    Gait,
    InPlaceSolver,
    NonEquilibrium,
    Periodic,
    Scales,
    Sponge,
    Strokes,
    compute_tau,
)
from fishrl.physics.bodies.motion import Bending, Driven, Free
from fishrl.physics.boundaries import Side
from fishrl.physics.collision import Rates
from fishrl.physics.skins import ImmersedBoundary, IterativeForcing
from fishrl.physics.step import step
from tests.physics.flows import start_stream

STEEP = Gait(amplitude=0.2, envelope=(0.0, 1.0, 0.0), wavenumber=2 * math.pi)
FAST = Boundaries(left=NonEquilibrium(velocity=(0.5, 0.0)))
TIGHT = Strokes(sequence=(replace(C_START.sequence[0], bend=(50.0, 0.0, 0.0)),))
LIGHT = Cylinder(diameter=16, density_ratio=0.7, motion=Free())
DENSE, FISH = Cylinder(diameter=40, num_markers=500), Fish(body_length=24)
scale = partial(Scales, body_length=100, reynolds=7000.0)
flow = partial(FlowConfig, width=128, height=64, tau=0.6)
fish = partial(Fish, body_length=50)
OTHER = flow(rates=Rates(energy=1.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: scale(period=601), "period = 601.*even"),
        (lambda: scale(period=400), "tail speed = .*raise period"),
        (lambda: scale(period=600, stream_speed_bl=1.2), "stream speed = 0.200.*raise period"),
        (lambda: scale(period=600, reynolds=1e6), "tau = 0.50005.*raise body_length"),
        (lambda: compute_tau(length=40.0, speed=0.0, reynolds=100.0), "must be positive"),
        (lambda: flow(tau=0.5), "tau = 0.50000 lies outside the validated range"),
        (lambda: flow(bodies=(fish(body_length=70),)), "does not fit into 128 x 64 nodes"),
        (lambda: flow(bodies=(Cylinder(diameter=9), FISH)), "the fish must come first"),
        (lambda: flow(bodies=(DENSE,), skin=ImmersedBoundary()), "0.25 nodes apart"),
        (
            lambda: flow(sponges=(Sponge(length=129),)),
            "Sponge of 129 nodes does not fit into 128 x",
        ),
        (lambda: flow(bodies=(LIGHT,), skin=ImmersedBoundary()), r"give skin = BounceBack\(\)"),
        (lambda: flow(sponges=(Sponge(length=65, side=Side.TOP),)), "Sponge of 65 nodes does not"),
        (lambda: flow(boundaries=FAST), "an edge imposes 0.500 nodes per step"),
        (lambda: IterativeForcing(relaxation=2.0), r"relaxation = 2.0: .*stable up to 1.90"),
        (lambda: Boundaries(left=Periodic()), "left and right must both be Periodic"),
        (NonEquilibrium, "give velocity, density or both"),
        (lambda: fish(gait=STEEP, keeps_length=True), "by 1.2. per unit of arc, a"),
        (lambda: fish(keeps_length=True, motion=Bending()), "not this Fish"),
        (lambda: fish(num_markers=101), "num_markers = 101: must be even"),
        (lambda: fish(strokes=TIGHT), "sections would overlap"),
        (lambda: Strokes(sequence=()), r"sequence = .*at least 1"),
        (lambda: Cylinder(diameter=20, motion=Bending()), "not this Cylinder"),
        (lambda: Cylinder(diameter=40, motion=Driven(angular_velocity=0.02)), "0.4 nodes per step"),
        (
            lambda: InPlaceSolver(config=[flow(), OTHER]),
            "flow 1 differs from flow 0 in more than tau",
        ),
        (
            lambda: InPlaceSolver(config=[flow()] * 2, num_envs=3),
            "num_envs = 3 with 2 configurations",
        ),
        (lambda: step(start_stream(flow()), flow(bodies=(FISH,))), "has 0 bodies, the config 1"),
    ],
)
def test_what_cannot_be_simulated_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
