"""Torque, work, added mass and prescribed motion."""

import math
from functools import partial
from typing import Any

import pytest
import torch

from fishrl.physics import BodyConfig, Cylinder, Fish, FlowConfig, InPlaceSolver, Scales
from fishrl.physics.bodies.motion import Commanded, Driven, Free
from fishrl.physics.cases import PERIODIC, make_swimmer_config
from fishrl.physics.collision import compute_macroscopic, compute_moments
from fishrl.physics.flow import make_params
from fishrl.physics.skins import BounceBack, DirectSolve, ImmersedBoundary, Skin
from fishrl.physics.skins.delta import interpolate
from fishrl.physics.skins.immersed_boundary import (
    couple_bodies,
    gather,
    gather_fluid,
    locate_bodies,
    spread,
)
from tests.physics.flows import advance, place_body, start_solver, start_stream

CENTRE = 30.3, 29.6
SCALES = Scales.from_budget(body_length=20, reynolds=500.0, max_wall_speed=0.1)


def make_box(body: BodyConfig, **changes: Any) -> FlowConfig:
    settings = {"boundaries": PERIODIC, "skin": ImmersedBoundary()} | changes
    return FlowConfig(width=60, height=60, tau=0.6, bodies=(body,), **settings)


DRIVEN = Cylinder(diameter=20, motion=Driven(angular_velocity=0.004))
SWIMMER = Fish(body_length=20, motion=Commanded())
BEATING = {"heading": 2.8, "frequency": 1 / SCALES.period, "turn_steps": 80, "turn_clock": 0}


@pytest.mark.parametrize(
    ("body", "start"),
    [
        (DRIVEN, {"angular_velocity": 0.004}),
        *((SWIMMER, BEATING | {"turn": turn}) for turn in (0.4, 0.0, -0.4)),
    ],
)
def test_torque_impulse_equals_the_fluids_angular_momentum(body: BodyConfig, start: Any) -> None:
    """Streaming and collision keep it, until 15 steps bring it to the edges."""
    config = make_box(body)
    state = advance(start_stream(config, place_body(*CENTRE, **start)), config, 15)
    _, jx, jy = compute_moments(state.f.unbind(1))
    x, y = (torch.arange(60.0) - c for c in CENTRE)
    given = float(state.bodies[0].torque_impulse)
    assert abs(given) > 1.0
    assert given == pytest.approx(float((x * jy - y[:, None] * jx).sum()), rel=1e-3)


def test_driven_body_moves_at_its_prescribed_velocity_from_any_state() -> None:
    motion = Driven(velocity=(0.03, -0.01), angular_velocity=0.002)
    config = make_box(Cylinder(diameter=12, motion=motion))
    wrong = place_body(*CENTRE, velocity=(0.05, 0.05), angular_velocity=0.1)
    state = advance(start_stream(config, wrong), config, 6)
    solver = start_solver(config, wrong.position)
    solver.body.velocity.copy_(wrong.velocity)
    solver.body.angular_velocity.copy_(wrong.angular_velocity)
    solver.advance_(6)
    for end in (state.bodies[0], solver.body):
        assert (end.position - wrong.position)[0].tolist() == pytest.approx([0.18, -0.06], rel=1e-9)
        assert float(end.heading) == pytest.approx(0.012, rel=1e-9)
        assert (end.velocity[0].tolist(), float(end.angular_velocity)) == ([0.03, -0.01], 0.002)
    # at a constant rate there is no inertia
    before, (after,) = state.bodies[0].torque_impulse, advance(state, config, 1).bodies
    torch.testing.assert_close(after.hydro_torque, before - after.torque_impulse)


def test_muscle_and_torque_work_equals_work_on_fluid() -> None:
    """The work on the water: each marker's force times the fluid's velocity there after it."""
    skin = ImmersedBoundary(force_solve=DirectSolve())
    config = make_swimmer_config(SCALES, length_bl=3, height_bl=3, bodies=(SWIMMER,), skin=skin)
    params = make_params([config])
    body = place_body(*CENTRE, **BEATING | {"heading": math.pi, "turn": 0.4})
    state = advance(start_stream(config, body), config, 40, params)
    (body,) = state.bodies
    bodies, size = (skin, config.bodies, params.bodies, (body,)), (config.width, config.height)
    geometry = locate_bodies(*bodies, size, torch.float64)
    nodes, weights = geometry.stencil.index_nodes(config.width), geometry.stencil.weights
    fluid = compute_macroscopic(state.f.unbind(1))
    nearby = gather_fluid(fluid, nodes)
    (after,), *shares = couple_bodies(*bodies, geometry, nearby)
    power = torch.zeros(1, dtype=torch.float64)
    for share, u in zip(shares, (fluid.ux, fluid.uy), strict=True):
        forced = u + spread(share, nodes, fluid.rho) / (2.0 * fluid.rho)
        power += (share.sum(1) * interpolate(gather(forced, nodes), weights)).sum(-1)
    muscles, torque = after.work - body.work, after.torque_work - body.torque_work
    assert abs(float(torque)) > 0.02 * abs(float(muscles))
    left = float(after.slip_error * sum(share.sum(1).abs().sum() for share in shares))
    assert left < 1e-5 * abs(float(power))  # what the solve leaves of the slip
    torch.testing.assert_close(muscles + torque, power, rtol=0, atol=left)


@pytest.mark.parametrize(("skin", "share"), [(ImmersedBoundary(), 1e-11), (BounceBack(), 1e-4)])
@pytest.mark.parametrize("density_ratio", [1.0, 2.0])
def test_no_torque_does_work_on_a_free_fish(density_ratio: float, skin: Skin, share: float) -> None:
    """To round-off; bounce-back leaves out the part of a force that is quadratic in the rates."""
    fish = Fish(body_length=20, motion=Free(), density_ratio=density_ratio)
    config = make_swimmer_config(SCALES, length_bl=3, height_bl=3, bodies=(fish,), skin=skin)
    body = place_body(*CENTRE, math.pi, 1 / SCALES.period)
    (body,) = advance(start_stream(config, body), config, 60).bodies
    assert abs(float(body.angular_velocity)) > 1e-5
    assert abs(float(body.torque_work)) < share * abs(float(body.work))


@pytest.mark.parametrize("size", [8, 16])
@pytest.mark.parametrize(("skin", "lightest"), [(ImmersedBoundary(), 0.0), (BounceBack(), 0.01)])
def test_lightest_disc_rises_by_its_added_mass(skin: Skin, lightest: float, size: int) -> None:
    """At first like mass and added mass of potential flow, one of water; its boundary layer brakes.

    Sound crosses the disc in some 30 steps at most.
    """
    disc = partial(Cylinder, diameter=size, motion=Free())
    ratio = max(lightest, skin.find_least_density(skin.fit(disc(density_ratio=2.0))))
    body, push = disc(density_ratio=ratio), 1e-5
    config = FlowConfig(width=4 * size, height=4 * size, tau=0.55, bodies=(body,), skin=skin)
    solver = InPlaceSolver(config=config, compile=False)
    solver.body.load[:, 1] = push * body.area
    solver.advance_(40)
    share = float(solver.body.velocity[0, 1]) * (1.0 + ratio) / (40 * push)
    solver.advance_(160)
    assert 0.5 < share < 1.0
    assert 0.0 < float(solver.body.velocity[0, 1]) * (1.0 + ratio) < 200 * push * share
