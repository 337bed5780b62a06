"""The fast step against the readable one, and what a batch promises."""

import logging
import math
from functools import cache
from typing import Any

import pytest
import torch
from torch.profiler import ProfilerActivity, profile

from fishrl.physics import Fish, FlowConfig, FlowState, Foil, InPlaceSolver, Stroke, Strokes
from fishrl.physics.bodies.motion import Bending, Commanded, Fixed, Free, Surging, Towed
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.boundaries import (
    Boundaries,
    NonEquilibrium,
    NoSlip,
    OpenEdge,
    Periodic,
    Profile,
    Side,
)
from fishrl.physics.cases import PERIODIC
from fishrl.physics.fast import compiled as compiled_module
from fishrl.physics.fast import execution as execution_module
from fishrl.physics.flow import Sponge, make_params, make_rest, make_uniform
from fishrl.physics.skins import BounceBack, DirectSolve, ImmersedBoundary, Skin
from fishrl.physics.step import step
from tests.physics.flows import SCALES, advance, make_tank, read_state, start_solver

STARTS = torch.tensor([[60.3, 36.4], [40.1, 30.7], [50.0, 41.0]], dtype=torch.float64)
HEADINGS = torch.tensor([math.pi, 2.5, -2.8], dtype=torch.float64)
TURN = torch.tensor([0.2, -0.2, 0.0], dtype=torch.float64)
TANK = make_tank()


def make_solver(
    config: FlowConfig = TANK, rows: slice = slice(None), **settings: Any
) -> InPlaceSolver:
    frequency = 1.0 / SCALES.period
    solver = start_solver(config, STARTS[rows], HEADINGS[rows], frequency=frequency, **settings)
    solver.command_(TURN[rows], 160)
    return solver


def assert_equal_to_reference(
    solver: InPlaceSolver, reference: FlowState, *, tolerance: float = 5e-6
) -> None:
    """Single against double precision, a few times what 120 steps were measured to differ by.

    1.7e-6 of the largest population, 7e-8 nodes, 1e-8 radians, 1.4e-7 of the work, impulse 2e-7.
    """
    scale, small = float(reference.f.abs().max()), 0.2 * tolerance
    assert scale > 0.005
    assert float((solver.populations() - reference.f).abs().max()) < tolerance * scale
    for got, expected in zip(solver.bodies, reference.bodies, strict=True):
        assert float((got.position - expected.position).abs().max()) < small
        assert float((got.heading - expected.heading).abs().max()) < 0.1 * small
        torch.testing.assert_close(got.work, expected.work, rtol=small, atol=small)
        torch.testing.assert_close(got.torque_work, expected.torque_work, rtol=small, atol=small)
        # forces that alternate leave an impulse far smaller than their own round-off allows for
        large = max(1.0, float(expected.impulse.abs().max()))
        assert float((got.impulse - expected.impulse).abs().max()) < small * large


STREAM, PINNED = NonEquilibrium(velocity=(1.0, 0.0)), NonEquilibrium(density=1.0)
INLET = Boundaries(left=STREAM, right=PINNED, bottom=NoSlip(), top=STREAM)
COUETTE = Boundaries(
    left=Periodic(), right=Periodic(), bottom=NoSlip(velocity=(-1.0, 0.0)), top=STREAM
)
ALONG = OpenEdge(is_plane=False)
PARABOLA = Profile.PARABOLA
EDGES = {
    "no-slip walls": Boundaries(left=NoSlip(), right=NoSlip(), bottom=NoSlip(), top=NoSlip()),
    "lid": Boundaries(left=NoSlip(), right=NoSlip(), bottom=NoSlip(), top=NoSlip(velocity=(1, 0))),
    "pinned outflow": Boundaries(left=STREAM, right=PINNED, bottom=STREAM, top=STREAM),
    "open edges": Boundaries(left=STREAM, right=OpenEdge(), bottom=ALONG, top=ALONG),
    "channel": Boundaries(
        left=NonEquilibrium(velocity=(1.0, 0.0), profile=PARABOLA),
        right=OpenEdge(profile=PARABOLA),
        bottom=NoSlip(),
        top=NoSlip(),
    ),
    "periodic along": Boundaries(left=Periodic(), right=Periodic(), bottom=NoSlip(), top=STREAM),
}


class OwnSkin(Skin):
    """The immersed boundary, with no parts of the fast step but the default."""

    marker_spacing, spacing_range = ImmersedBoundary.marker_spacing, ImmersedBoundary.spacing_range
    margin, jumps, has_water_inside = ImmersedBoundary.margin, False, True

    def exchange(self, *water_and_bodies: Any) -> Any:
        return ImmersedBoundary().exchange(*water_and_bodies)


BEND, STRAIGHT = (-1.0, -0.4, -0.2), (0.0, 0.0, 0.0)
STROKES = Strokes(
    sequence=(
        Stroke(duration=0.3, bend=BEND, wave=BEND, lag=0.7),
        Stroke(duration=0.5, bend=STRAIGHT, wave=BEND, lag=0.7),
    ),
    phase=1.0,
)
CHANGES: dict[str, dict[str, Any]] = {
    "commanded": {"motion": Commanded()},
    "free": {"motion": Free()},
    "held": {"motion": Fixed()},
    "bending": {"motion": Bending()},
    "towed": {"motion": Towed()},
    "surging": {"bodies": (Foil(chord=24, motion=Surging(pitch=0.3, pivot=10.0)),)},
    "constant length": {"bodies": (Fish(body_length=24, keeps_length=True, motion=Free()),)},
    "strokes": {"bodies": (Fish(body_length=24, strokes=STROKES, motion=Free()),)},
    "sheared": {"boundaries": COUETTE, "stream_speed": 0.03, "ramp_steps": 50},
    "sponges": {
        "boundaries": INLET,
        "stream_speed": 0.03,
        "sponges": (Sponge(length=20), Sponge(length=8, side=Side.TOP)),
    },
    "in a sponge": {"boundaries": INLET, "stream_speed": 0.03, "sponges": (Sponge(length=90),)},
    "skin of one's own": {"skin": OwnSkin(), "sponges": (Sponge(length=20),)},
    "direct solve": {"skin": ImmersedBoundary(force_solve=DirectSolve())},
    "sharp skin": {"bodies": (Fish(body_length=24, motion=Free()),), "skin": BounceBack()},
    "periodic both ways": {"boundaries": PERIODIC},
    **{name: {"boundaries": edges, "stream_speed": 0.02} for name, edges in EDGES.items()},
}


@pytest.mark.parametrize(
    ("name", "num_steps"),
    [*((n, 120 if "boundaries" in CHANGES[n] else 60) for n in CHANGES), ("open edges", 400)],
)
def test_many_steps_in_place_and_one_more_equal_readable_steps(name: str, num_steps: int) -> None:
    """Sound crosses 69 nodes in 120 steps, so what the edges send has met."""
    config, rows = make_tank(**CHANGES[name]), slice(1) if name in EDGES else slice(3)
    solver = make_solver(config, rows, flows_per_launch=len(STARTS[rows]))
    reference = advance(read_state(solver), config, num_steps)
    solver.advance_(num_steps)
    assert_equal_to_reference(solver, reference, tolerance=5e-5 if num_steps == 400 else 5e-6)
    (grid,) = solver._batch.grids
    for part, tensors in grid.list_step(0, 0):
        part.run(*tensors)
    after_odd = torch.stack(grid.memory_of(0).incoming(1), 1)
    error = (after_odd - step(reference, config).f).abs().max() / reference.f.abs().max()
    assert float(error) < 5e-5


def test_changing_stream_equals_the_readable_step_and_resumes() -> None:
    config = make_tank(**CHANGES["sheared"])
    solver, other = (make_solver(config, flows_per_launch=3) for _ in range(2))
    state, params = advance(read_state(solver), config, 60), make_params([config] * 3)
    speed = torch.tensor([0.05, 0.06, 0.02], dtype=torch.float64)
    solver.advance_(60)
    solver.set_stream_speed_(speed, torch.tensor([True, False, True]), num_steps=40)
    solver.advance_(20)
    with pytest.raises(ValueError, match=r"imposes 0\.480 nodes per step"):
        solver.set_stream_speed_(8.0 * speed)
    assert solver.stream_speed.tolist() == pytest.approx([0.04, 0.03, 0.025])
    other.load_state_dict(solver.state_dict())
    for each in (solver, other):
        each.advance_(40)
    assert torch.equal(solver.populations(), other.populations())
    for name, a, b in zip(BodyState._fields, other.body, solver.body, strict=True):
        assert torch.equal(a, b), name
    assert solver.stream_speed.tolist() == pytest.approx([0.05, 0.03, 0.02])
    changed = params._replace(
        stream_speed=solver.stream_speed,
        former_speed=params.stream_speed,
        ramp_steps=torch.full_like(speed, 40.0),
        ramp_start=torch.full_like(speed, 60.0),
    )
    assert_equal_to_reference(solver, advance(state, config, 60, changed))
    solver.reset_(torch.tensor([True, False, False]), STARTS, HEADINGS)
    assert solver.stream_speed.tolist() == pytest.approx([0.0, 0.03, 0.02])
    solver.advance_(50)  # the rise from rest, as configured
    assert solver.stream_speed.tolist() == pytest.approx([0.05, 0.03, 0.02])


@pytest.mark.compile
@pytest.mark.parametrize(
    "name",
    ["sharp skin", *(pytest.param(n, marks=pytest.mark.slow) for n in ("commanded", "strokes"))],
)
def test_compiled_step_equals_the_readable_one_here_and_in_a_worker(name: str) -> None:
    config = make_tank(**CHANGES[name])
    solver, twin = (make_solver(config, compile=True, num_workers=num) for num in (0, 1))
    reference = advance(read_state(solver), config, 120)
    for each in (solver, twin):
        each.advance_(120)
    assert torch.equal(solver.populations(), twin.populations())
    assert torch.equal(solver.body.position, twin.body.position)
    assert_equal_to_reference(solver, reference)
    twin.close()


@pytest.mark.compile
def test_compiled_step_takes_no_memory_that_grows_with_the_grid() -> None:
    config = make_tank(**CHANGES["sharp skin"])  # compiled by another test
    solver = make_solver(config, slice(1), compile=True)
    solver.advance_(4)
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as record:
        solver.advance_(10)
    largest = max((event.self_cpu_memory_usage for event in record.events()), default=0)
    field = 4 * config.width * config.height
    assert largest < field, f"an operation of a step allocates {largest} bytes"


def test_step_and_reset_change_their_rows_alone() -> None:
    solver, fresh = make_solver(), make_solver()
    assert torch.equal(solver.populations().double(), make_rest(TANK, 3))
    body = make_body(STARTS, HEADINGS, torch.full((3,), 1.0 / SCALES.period, dtype=torch.float64))
    body = body._replace(turn=TURN, turn_steps=torch.full_like(TURN, 160.0), turn_clock=0.0 * TURN)
    for name, got, expected in zip(BodyState._fields, solver.body, body, strict=True):
        assert torch.equal(got, expected), name
    rows = torch.tensor([True, False, True])
    solver.advance_(20, rows)
    fresh.advance_(20)
    assert torch.equal(solver.populations()[rows], fresh.populations()[rows])
    assert solver.body.age.tolist() == [20.0, 0.0, 20.0]
    solver.advance_(20, ~rows)
    fresh.reset_(rows | ~rows, STARTS, HEADINGS)
    before = solver.state_dict()
    solver.reset_(~rows, STARTS, HEADINGS)
    for name, values in solver.state_dict().items():
        assert torch.equal(values[rows], before[name][rows]), name
    fresh.command_(0 * TURN, 160)
    solver.command_(0 * TURN, 160)
    fresh.advance_(20)
    solver.advance_(20)
    assert torch.equal(solver.populations()[1], fresh.populations()[1])


def test_diverged_row_is_flagged_and_harms_no_other() -> None:
    solver, healthy = make_solver(), make_solver()
    f = solver.populations()
    f[1, 3, 20, 20] = float("nan")
    solver.set_populations_(f)
    for each in (solver, healthy):
        each.advance_(40)
    assert solver.is_diverged().tolist() == [False, True, False]
    for i in (0, 2):
        assert torch.equal(solver.populations()[i], healthy.populations()[i])
    solver.reset_(solver.is_diverged(), STARTS, HEADINGS)
    assert not solver.is_diverged().any()
    solver.body.position[2, 0] = -5.0  # outside the grid
    solver.advance_(2)
    assert solver.is_diverged().tolist() == [False, False, True]


@pytest.mark.parametrize("is_reported", [True, False], ids=["all rows", "named rows"])
def test_divergence_is_reported_once(is_reported: bool, caplog: pytest.LogCaptureFixture) -> None:
    config = FlowConfig(width=20, height=16, tau=0.6)
    solver = start_solver(config, num_envs=3, flows_per_launch=3)
    every = torch.tensor([True, True, True])

    def count_reports(*diverged: int) -> int:
        caplog.clear()
        f = solver.populations()
        f[list(diverged), 3, 10, 10] = torch.nan
        solver.set_populations_(f)
        for _ in range(2):
            solver.advance_(20, None if is_reported else every)
        return caplog.text.count(f"flows {list(diverged)} have diverged")

    assert count_reports(0, 2) == is_reported
    assert not caplog.records[is_reported:]
    solver.reset_(every)
    assert count_reports() == 0 and not caplog.records
    for _ in range(2):
        assert count_reports(1) == is_reported
        solver.reset_(every)


@pytest.mark.parametrize(
    ("speed", "f0", "is_over"),
    [(0.45, None, False), (0.55, None, True), *((0.0, f0, True) for f0 in (-2.0, 2.0, math.inf))],
)
def test_impossible_flows_count_as_diverged(speed: float, f0: float | None, is_over: bool) -> None:
    """Densities: negative, twice that at rest, or infinite while the momentum is finite."""
    solver = make_solver()
    f = solver.populations()
    none = torch.zeros_like(f[:1, 0])
    f[1] = make_uniform(none, none + speed, none)[0]
    if f0 is not None:
        f[1, 0, 20, 20] = f0
    solver.set_populations_(f)
    assert solver.is_diverged().tolist() == [False, is_over, False]


def test_without_a_compiler_flows_run_eagerly_with_a_warning(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    find = cache(compiled_module.find_compiler_problem.__wrapped__)
    for module in (compiled_module, execution_module):  # neither has looked for a compiler yet
        monkeypatch.setattr(module, "find_compiler_problem", find)
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    with caplog.at_level(logging.WARNING):
        solver = InPlaceSolver(config=TANK, num_envs=3, frequency=1.0 / SCALES.period)
        solver.advance_(2)
    assert [r.message for r in caplog.records if "runs eagerly" in r.message] == [
        "no C++ compiler (g++ or clang++) on the path: the flow runs eagerly, about 50 times slower"
    ]
    assert not solver.is_diverged().any()


def make_noise(flows_per_launch: int = 1) -> InPlaceSolver:
    config = FlowConfig(width=12, height=9, tau=0.6)
    solver = start_solver(config, num_envs=4, flows_per_launch=flows_per_launch)
    generator = torch.Generator().manual_seed(0)
    solver.set_populations_(0.01 * torch.randn(4, 9, 9, 12, generator=generator))
    return solver


@pytest.mark.parametrize("flows_per_launch", [1, 2])
def test_some_flows_are_read_as_among_all(flows_per_launch: int) -> None:
    solver = make_noise(flows_per_launch)
    whole = solver.macroscopic()
    for number in range(2**4):
        rows = torch.tensor([bool(number >> row & 1) for row in range(4)])
        for some, every in zip(solver.macroscopic(rows), whole, strict=True):
            assert torch.equal(some, every[rows])


@pytest.mark.parametrize("flows_per_launch", [1, 2])
def test_sampling_is_bilinear_and_clamped_to_grid(flows_per_launch: int) -> None:
    solver = make_noise(flows_per_launch)
    solver.advance_(2)
    density, velocity = solver.sample(torch.tensor([[[3.25, 4.5]]]).expand(4, 1, 2))
    rho, u = solver.macroscopic()
    fields = torch.cat((rho[:, None], u), 1)
    low, high = (0.75 * fields[:, :, y, 3] + 0.25 * fields[:, :, y, 4] for y in (4, 5))
    expected = 0.5 * (low + high)
    torch.testing.assert_close(torch.cat((density[..., None], velocity), -1)[:, 0], expected)
    outside = torch.tensor([[-5.0, 20.0], [99.0, 3.0], [torch.nan, 2.0]]).expand(4, 3, 2)
    edge = torch.tensor([[0.0, 8.0], [11.0, 3.0], [0.0, 2.0]]).expand(4, 3, 2)
    for got, wanted in zip(solver.sample(outside), solver.sample(edge), strict=True):
        torch.testing.assert_close(got[:, :2], wanted[:, :2])
        assert got[:, 2].isnan().all()
