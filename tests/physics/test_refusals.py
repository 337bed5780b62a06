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
from fishrl.physics.bodies.motion import Bending, Free
from fishrl.physics.boundaries import Side
from fishrl.physics.collision import Rates
from fishrl.physics.skins import ImmersedBoundary, IterativeForcing

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
        (lambda: scale(period=600, stream_speed_bl=1.2), "stream speed = 0.200.*raise period"),
        (lambda: compute_tau(length=40.0, speed=0.0, reynolds=100.0), "must be positive"),
        (lambda: flow(bodies=(DENSE,), skin=ImmersedBoundary()), "0.25 nodes apart"),
        (lambda: flow(sponges=(Sponge(length=65, side=Side.TOP),)), "Sponge of 65 nodes does not"),
        (lambda: IterativeForcing(relaxation=2.0), r"relaxation = 2.0: .*stable up to 1.90"),
        (lambda: Boundaries(left=Periodic()), "left and right must both be Periodic"),
        (lambda: Strokes(sequence=()), r"sequence = .*at least 1"),
        (lambda: Cylinder(diameter=20, motion=Bending()), "not this Cylinder"),
        (
            lambda: InPlaceSolver(config=[flow(), OTHER]),
            "flow 1 differs from flow 0 in more than tau",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
