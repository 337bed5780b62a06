"""Torque, prescribed motion and derivatives, through the readable step in float64."""

import math
from functools import partial

import pytest
import torch
from torch import Tensor

from fishrl.physics import BodyConfig, Cylinder, Fish, FlowConfig, FlowState, InPlaceSolver, Scales
from fishrl.physics.bodies.motion import Commanded, Driven, Free
from fishrl.physics.bodies.state import make_body
from fishrl.physics.cases import PERIODIC, make_swimmer_config
from fishrl.physics.collision import compute_macroscopic, compute_moments
from fishrl.physics.flow import make_params, make_rest, make_uniform
from fishrl.physics.skins import BounceBack, DirectSolve, ImmersedBoundary, Skin
from fishrl.physics.skins.delta import interpolate
from fishrl.physics.skins.immersed_boundary import (
    couple_bodies,
    gather,
    gather_fluid,
    locate_bodies,
    spread,
)
from fishrl.physics.step import step
from tests.physics.flows import advance, start_solver

CENTRE = torch.tensor([[30.3, 29.6]], dtype=torch.float64)
ONE = torch.ones(1, dtype=torch.float64)


def make_box(body: BodyConfig) -> FlowConfig:
    """Return a periodic box with an immersed boundary."""
    return FlowConfig(
        width=60, height=60, tau=0.6, bodies=(body,), boundaries=PERIODIC, skin=ImmersedBoundary()
    )


@pytest.mark.parametrize("rate", [0.004, -0.004])
def test_torque_impulse_of_a_turning_cylinder_equals_the_fluids_angular_momentum(
    rate: float,
) -> None:
    """Streaming and collision keep angular momentum, until 15 steps bring it to the edges."""
    cylinder = Cylinder(diameter=20, motion=Driven(angular_velocity=rate))
    config = make_box(cylinder)
    params = make_params([config])
    body = make_body(CENTRE, 0 * ONE, 0 * ONE)._replace(angular_velocity=rate * ONE)
    state, felt = FlowState(make_rest(config, 1), (body,)), 0.0
    for _ in range(15):
        state = step(state, config, params)
        felt += float(state.bodies[0].hydro_torque)
    given = float(state.bodies[0].torque_impulse)
    assert given * rate > 0  # the cylinder takes the fluid along
    assert given == pytest.approx(measure_spin(state), rel=1e-3)
    assert felt == pytest.approx(-given, rel=1e-12)  # at a constant rate there is no inertia


@pytest.mark.parametrize("turn", [0.4, 0.0, -0.4])
def test_torque_impulse_of_a_commanded_fish_equals_the_fluids_angular_momentum(turn: float) -> None:
    """As above, while the fish beats, drifts and turns by command."""
    fish = Fish(body_length=20, motion=Commanded())
    config = make_box(fish)
    body = make_body(CENTRE, 2.8 * ONE, ONE / SCALES.period)
    body = body._replace(turn=turn * ONE, turn_steps=80 * ONE, turn_clock=0 * ONE)
    state = advance(FlowState(make_rest(config, 1), (body,)), config, 15)
    given = float(state.bodies[0].torque_impulse)
    assert abs(given) > 1.0
    assert given == pytest.approx(measure_spin(state), rel=1e-3)


def measure_spin(state: FlowState) -> float:
    """Return the fluid's angular momentum about ``CENTRE``."""
    _, jx, jy = compute_moments(state.f.unbind(1))
    x, y = (torch.arange(60.0) - c for c in CENTRE[0])
    return float((x * jy - y[:, None] * jx).sum())


def test_a_driven_body_moves_at_its_prescribed_velocity_from_any_state() -> None:
    """In the readable and in the in-place step; a sum of six numbers is exact to round-off."""
    motion = Driven(velocity=(0.03, -0.01), angular_velocity=0.002)
    body = Cylinder(diameter=12, motion=motion)
    config = make_box(body)
    wrong = {"velocity": torch.full((1, 2), 0.05).double(), "angular_velocity": 0.1 * ONE}
    start = make_body(CENTRE, 0 * ONE, 0 * ONE)._replace(**wrong)
    state = FlowState(make_rest(config, 1), (start,))
    state = advance(state, config, 6)
    solver = start_solver(config, CENTRE)
    for name, value in wrong.items():
        getattr(solver.body, name).copy_(value)
    solver.advance_(6)
    for end in (state.bodies[0], solver.body):
        assert (end.position - CENTRE)[0].tolist() == pytest.approx([0.18, -0.06], rel=1e-9)
        assert float(end.heading) == pytest.approx(0.012, rel=1e-9)
        assert (end.velocity[0].tolist(), float(end.angular_velocity)) == ([0.03, -0.01], 0.002)


def test_muscles_and_torque_of_a_turning_fish_do_the_work_on_the_water() -> None:
    """The work on the water: each marker's force times the fluid's velocity there after it."""
    fish = Fish(body_length=20, motion=Commanded())
    skin = ImmersedBoundary(force_solve=DirectSolve())
    config = make_swimmer_config(SCALES, length_bl=3, height_bl=3, bodies=(fish,), skin=skin)
    params = make_params([config])
    body = make_body(CENTRE, math.pi * ONE, ONE / SCALES.period)
    body = body._replace(turn=0.4 * ONE, turn_steps=80 * ONE, turn_clock=0 * ONE)
    state = advance(FlowState(make_rest(config, 1), (body,)), config, 40, params)
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
    body = make_body(CENTRE, math.pi * ONE, ONE / SCALES.period)
    (body,) = advance(FlowState(make_rest(config, 1), (body,)), config, 60).bodies
    assert abs(float(body.angular_velocity)) > 1e-5
    assert abs(float(body.torque_work)) < share * abs(float(body.work))


SCALES = Scales.from_budget(body_length=20, reynolds=500.0, max_wall_speed=0.1)


def swim(phase: Tensor, speed: Tensor, skin: Skin) -> Tensor:
    """Return what a fish did in three steps, begun at a phase, in a stream of a speed."""
    fish = Fish(body_length=20, motion=Free())
    config = make_swimmer_config(SCALES, length_bl=3, height_bl=3, bodies=(fish,), skin=skin)
    body = make_body(CENTRE, math.pi * ONE, ONE / SCALES.period)
    body = body._replace(phase=phase[None], beats=2 * ONE)
    none = torch.zeros(1, config.height, config.width, dtype=torch.float64)
    state = FlowState(make_uniform(none, none + speed, none), (body,))
    state = advance(state, config, 3)
    (body,) = state.bodies
    return torch.stack((body.position[0, 1], body.work[0], state.f[0, 1, 30, 22]))


@pytest.mark.parametrize("skin", [ImmersedBoundary(), BounceBack()])
def test_place_work_and_populations_can_be_differentiated(skin: Skin) -> None:
    """By the phase of the beat and the stream's speed, against central differences."""
    at = torch.tensor([0.7, 0.02], dtype=torch.float64)
    got = torch.autograd.functional.jacobian(lambda p: swim(*p, skin), at)
    for shift, column in zip(1e-5 * torch.eye(2, dtype=torch.float64), got.T, strict=True):
        rise = (swim(*(at + shift), skin) - swim(*(at - shift), skin)) / 2e-5
        assert (rise.abs() > 1e-6).all()
        torch.testing.assert_close(column, rise, rtol=1e-5, atol=0)


@pytest.mark.parametrize("skin", [ImmersedBoundary(), BounceBack()])
def test_a_fish_that_does_not_beat_drifts_with_the_stream_from_the_first_step(
    skin: Skin,
) -> None:
    """In single precision."""
    fish = Fish(body_length=24, motion=Commanded())
    config = FlowConfig(
        width=60,
        height=60,
        tau=0.6,
        bodies=(fish,),
        stream_speed=0.05,
        boundaries=PERIODIC,
        skin=skin,
    )
    solver = start_solver(config, CENTRE, 0.7 * ONE, velocity=(1.0, -0.4))
    for steps in (2, 40):
        solver.advance_(steps)
        drift = (solver.body.position - CENTRE)[0] / solver.body.age
        assert drift.tolist() == pytest.approx([0.05, -0.02], abs=1e-6)
    assert float(solver.body.hydro_force.abs().max()) < 1e-5


@pytest.mark.parametrize("size", [8, 16])
@pytest.mark.parametrize(("skin", "lightest"), [(ImmersedBoundary(), 0.0), (BounceBack(), 0.01)])
def test_the_lightest_disc_rises_as_its_added_mass_says(
    skin: Skin, lightest: float, size: int
) -> None:
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
