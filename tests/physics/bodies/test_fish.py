"""The fish: outline, kinematics and its coupling to the flow, in float64."""

import math
from functools import partial

import pytest
import torch

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.gait import GAITS, Deformation, Gait
from fishrl.physics.bodies.midline import MidlineParams
from fishrl.physics.bodies.motion import Bending, Commanded, Free, Motion, Towed, compute_turn_rate
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.cases import PERIODIC
from fishrl.physics.collision import compute_moments
from fishrl.physics.flow import FlowState, make_params, make_rest
from fishrl.physics.geometry import deform_body, locate_markers, locate_outline, place_markers
from fishrl.physics.skins import ImmersedBoundary
from fishrl.physics.step import step
from tests.physics.flows import (
    SCALES,
    advance,
    make_tank,
    measure_polygon,
    place_body,
    start_stream,
)

FIT = ImmersedBoundary().fit
STILL = Gait(amplitude=0.0, envelope=(0.0, 1.0, 0.0), wavenumber=1.0)
MOTIONS = [Free(), Commanded(), Bending()]
with_each_motion = pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: type(m).__name__)
make_fish_body = partial(place_body, x=40.3, y=30.6, heading=math.pi, frequency=1 / SCALES.period)


def outline(fish: Fish, body: BodyState) -> torch.Tensor:
    return place_markers(body, deform_body(fish, fish.make_params(), body)).position


def measure_momentum(f: torch.Tensor) -> torch.Tensor:
    _, jx, jy = compute_moments(f.unbind(1))
    return torch.stack((jx.sum((-1, -2)), jy.sum((-1, -2))), -1)


@with_each_motion
def test_markers_move_at_the_velocity_imposed_on_the_flow(motion: Motion) -> None:
    config = make_tank(motion=motion)
    (fish,), params = config.bodies, make_params([config])
    body = make_fish_body(turn=0.3, turn_steps=200, turn_clock=0, amplitude_goal=0.4)
    state, worst = start_stream(config, body), 0.0
    for _ in range(SCALES.period + 40):
        place = locate_outline(fish, params.bodies[0], state.bodies[0]).markers
        state = step(state, config, params)
        (body,) = state.bodies
        after = locate_outline(fish, params.bodies[0], body).markers
        rx, ry = place.arm.unbind(-1)
        omega = body.angular_velocity[:, None]
        rigid = body.velocity[:, None] + torch.stack((-omega * ry, omega * rx), -1)
        moved = after.position - place.position
        worst = max(worst, float((moved - rigid - place.deformation_velocity).abs().max()))
    # the acceleration of the tail is (2 pi / T) times its speed; half of it is the error of a step
    assert worst < 1.5 * math.pi / SCALES.period * SCALES.tail_speed


@pytest.mark.parametrize("beats", [0.3, 4.0], ids=["while the amplitude rises", "later"])
def test_changing_the_frequency_does_not_move_the_body(beats: float) -> None:
    fish, body = Fish(body_length=50), make_fish_body(beats=beats, phase=1.3)
    places = [outline(fish, body._replace(frequency=f * body.frequency)) for f in (0.0, 1.0, 2.0)]
    for place in places[1:]:
        torch.testing.assert_close(places[0], place, rtol=0, atol=1e-12)


@pytest.mark.parametrize("is_midline", [False, True])
def test_half_the_amplitude_is_half_the_sway_of_the_tail(is_midline: bool) -> None:
    fish = FIT(Fish(body_length=50, keeps_length=is_midline))
    sway = []
    for one in (make_fish_body(beats=2), make_fish_body(beats=2, amplitude=0.5)):
        phases = one.phase + torch.linspace(0, 2 * math.pi, 25)[:, None]
        places = torch.cat([outline(fish, one._replace(phase=phase)) for phase in phases])
        tail = places[:, fish.num_markers // 2, 1]
        sway.append(float(tail.max() - tail.min()))
    assert sway[1] == pytest.approx(0.5 * sway[0], rel=0.02)


def sum_over_body(bent: Deformation) -> tuple[float, float, float]:
    """Return angular momentum, its sum without signs, and the polar moment of area.

    From the outline alone, over cells between 41 points on each line that joins facing markers.
    """
    upper = torch.arange(bent.axial.shape[1] // 2 + 1)
    across = torch.linspace(0.0, 1.0, 41, dtype=torch.float64)
    x, y, u, v = (
        torch.lerp(q[0, upper, None], q[0, -upper, None], across)
        for q in (bent.axial, bent.lateral, bent.axial_velocity, bent.lateral_velocity)
    )
    (x1, x2), (y1, y2) = ((q[1:, 1:] - q[:-1, :-1], q[1:, :-1] - q[:-1, 1:]) for q in (x, y))
    area = 0.5 * (x1 * y2 - x2 * y1).abs()
    x, y, u, v = (0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]) for q in (x, y, u, v))
    momentum = area * (x * v - y * u)
    inertia = area * (x * x + y * y)
    return float(momentum.sum()), float(momentum.abs().sum()), float(inertia.sum())


def assert_no_angular_momentum(bent: Deformation) -> None:
    """Against sums over the body: H + spin I is 0.14 % of the sum of |dH| at most, as measured."""
    momentum, size, inertia = sum_over_body(bent)
    assert abs(momentum + float(bent.spin) * inertia) < 5e-3 * size
    assert inertia == pytest.approx(float(bent.inertia), rel=5e-3)


def assert_midline_keeps_length_area_and_centre(
    fish: Fish, body: BodyState, before: torch.Tensor, after: torch.Tensor
) -> None:
    """``before`` and ``after`` are the outlines half a step earlier and later."""
    shape, places, half = fish.make_params(), outline(fish, body)[0], fish.num_markers // 2
    assert isinstance(shape, MidlineParams)
    spine = 0.5 * (places[1:half] + places[half + 1 :].flip(0))
    length = float((spine[1:] - spine[:-1]).norm(dim=-1).sum())
    ends = shape.step.cumsum(1)[0, shape.station[0, [1, half - 1]].long()]
    assert length == pytest.approx(float(ends[1] - ends[0]), rel=2e-3)
    area, centre = measure_polygon(places)
    assert area == pytest.approx(fish.area, rel=2e-3)
    assert float((centre - body.position[0]).abs().max()) < 0.05
    # the markers' displacement over a step is their velocity (the frame turns by its own rate)
    bent, arm = deform_body(fish, shape, body), places - body.position[0]
    imposed = place_markers(body, bent).deformation_velocity
    moved = after - before + torch.stack((-arm[:, 1], arm[:, 0]), -1) * bent.spin
    assert float((moved - imposed).abs().max()) < 5e-3 * float(imposed.abs().max())


@pytest.mark.parametrize("is_midline", [False, True])
@pytest.mark.parametrize("gait", GAITS.values(), ids=GAITS.keys())
def test_deformation_keeps_area_centre_and_angular_momentum(gait: Gait, is_midline: bool) -> None:
    fish = FIT(Fish(body_length=100, gait=gait, keeps_length=is_midline))
    for phase in (0.2, 1.7, 4.0):
        body = make_fish_body(beats=1e3, phase=phase)
        assert_no_angular_momentum(deform_body(fish, fish.make_params(), body))
        if is_midline:
            turn = math.pi * body.frequency  # of half a step
            around = (outline(fish, body._replace(phase=body.phase + d * turn)) for d in (-1, 1))
            assert_midline_keeps_length_area_and_centre(fish, body, *around)
            continue
        area, centre = measure_polygon(outline(fish, body)[0])
        assert area == pytest.approx(fish.area, rel=0.005)
        assert (centre - body.position[0]).abs().max() < 0.05


def test_a_commanded_turn_ends_at_the_commanded_heading() -> None:
    body = make_fish_body(turn=0.26, turn_steps=300, turn_clock=0)
    turn_rates = [
        float(compute_turn_rate(body._replace(turn_clock=body.turn_clock + clock)))
        for clock in range(400)
    ]
    assert sum(turn_rates) == pytest.approx(0.26, rel=1e-12)
    assert max(turn_rates) < 2.01 * 0.26 / 300
    rates = [Bending(response=each).compute_bend_rate(body).item() for each in (6.0, 2.0)]
    assert rates == pytest.approx([-0.0052, -0.0052 / 3.0])


@with_each_motion
@pytest.mark.parametrize("density_ratio", [1.0, 2.0])
def test_fluid_and_body_conserve_momentum(motion: Motion, density_ratio: float) -> None:
    fish = Fish(body_length=24, density_ratio=density_ratio, motion=motion)
    config = make_tank(boundaries=PERIODIC, bodies=(fish,))
    state = advance(start_stream(config, make_fish_body()), config, 100)
    excess = (density_ratio - 1.0) * fish.area
    total = measure_momentum(state.f) + excess * state.bodies[0].velocity
    assert state.bodies[0].velocity.abs().max() > 1e-3
    assert total.abs().max() < 1e-11


def test_towed_fish_keeps_its_speed_and_conserves_lateral_momentum() -> None:
    config = make_tank(boundaries=PERIODIC, motion=Towed())
    body = make_fish_body(heading=0.4, velocity=(0.01, 0.0))
    state = advance(start_stream(config, body), config, 60)
    (after,) = state.bodies
    assert after.velocity[0, 0] == 0.01 and after.velocity[0, 1].abs() > 1e-4
    assert measure_momentum(state.f)[0, 1].abs() < 1e-11


def test_power_of_free_fish_is_that_of_its_muscles() -> None:
    """With no net force and torque the rigid motion does no work: F . u_def = F . V."""
    config = make_tank(motion=Free())
    (body,) = advance(start_stream(config, make_fish_body()), config, 80).bodies
    assert float(body.force.abs().max()) < 1e-12
    # the lateral part misses only the work of -H/I against a torque that is zero
    assert float(body.lateral_work) == pytest.approx(float(body.work), rel=1e-6)
    assert float(body.work) > 0


def test_bending_turns_a_beating_fish_without_external_torque() -> None:
    config = make_tank(motion=Bending())
    both = torch.ones(2, dtype=torch.float64)
    body = make_body(
        torch.tensor([[40.3, 30.6]] * 2).double(), math.pi * both, both / SCALES.period
    )
    turn = torch.tensor([0.5, -0.5], dtype=torch.float64)
    body = body._replace(turn=turn, turn_steps=SCALES.period * both, turn_clock=0 * both)
    state = advance(FlowState(make_rest(config, 2), (body,)), config, SCALES.period + 100)
    after = state.bodies[0]
    assert float(after.force.abs().max()) < 1e-12
    turned = after.heading + after.internal_angle
    assert (after.bend.abs() > 0.01).all()
    assert turned[0] - turned[1] > 0.1


@pytest.mark.parametrize("is_midline", [False, True])
def test_markers_located_without_their_motion_are_the_same(is_midline: bool) -> None:
    fish = Fish(body_length=24, keeps_length=is_midline)
    shape, body = fish.make_params(), make_fish_body(heading=2.5, phase=0.7, beats=0.6, bend=0.02)
    assert isinstance(shape, MidlineParams) == is_midline
    expected = place_markers(body, deform_body(fish, shape, body)).position
    assert torch.equal(locate_markers(shape, body), expected)


@with_each_motion
def test_body_carried_by_a_uniform_stream_leaves_it_unchanged(motion: Motion) -> None:
    config = make_tank(
        boundaries=PERIODIC, bodies=(Fish(body_length=24, gait=STILL, motion=motion),)
    )
    stream = (0.05, -0.02)
    body = make_fish_body(heading=0.4, velocity=stream)
    before = start_stream(config, body, velocity=stream)
    state = advance(before, config, 60)
    torch.testing.assert_close(state.f, before.f, rtol=0, atol=1e-14)
    expected = body.position + 60 * body.velocity
    torch.testing.assert_close(state.bodies[0].position, expected, rtol=0, atol=1e-10)


def test_mirrored_fish_swims_the_mirrored_path() -> None:
    config = make_tank()
    height = config.height - 1.0
    up = make_fish_body(x=60.0, y=30.0)
    down = make_fish_body(x=60.0, y=height - 30.0, phase=math.pi)  # the mirrored wave
    paths = [advance(start_stream(config, body), config, 100).bodies[0] for body in (up, down)]
    (x, y), (mirrored_x, mirrored_y) = (body.position[0].tolist() for body in paths)
    assert (x, y) == pytest.approx((mirrored_x, height - mirrored_y), abs=1e-9)
