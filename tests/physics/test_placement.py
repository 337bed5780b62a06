"""Bodies that lie in each other or beyond the grid are refused, or named as they come to it."""

from collections.abc import Callable
from functools import partial
from math import pi

import pytest
import torch

from fishrl.physics import (
    Boundaries,
    Cylinder,
    Driven,
    Ellipse,
    Fish,
    Fixed,
    FlowConfig,
    FlowState,
    Free,
    ImmersedBoundary,
    InPlaceSolver,
    Skin,
    simulate,
)
from fishrl.physics.bodies.motion import Motion
from fishrl.physics.cases import PERIODIC
from fishrl.physics.flow import make_params, make_rest
from fishrl.physics.levels.grids import make_patches
from tests.physics.flows import place_body

EVERY = torch.tensor([True, True])
SKINS = [kind() for kind in Skin.__subclasses__()]


def make_solver(*bodies: Cylinder | Ellipse | Fish) -> InPlaceSolver:
    config = FlowConfig(width=100, height=60, tau=0.6, bodies=bodies, skin=ImmersedBoundary())
    return InPlaceSolver(config=config, num_envs=2, compile=False)


def place(solver: InPlaceSolver, *places: tuple[float, float], heading: float = 0.0) -> None:
    """Reset both flows: the first with bodies that are well apart, the second as given."""
    apart = [(25.0 + 40.0 * number, 30.0) for number in range(len(places))]
    headings = torch.tensor([[0.0] * len(places), [heading] * len(places)])
    solver.reset_(EVERY, torch.tensor([apart, list(places)]), headings)


def test_overlapping_bodies_are_refused_in_any_position() -> None:
    discs = Cylinder(diameter=12, inset=0.0), Cylinder(diameter=16, inset=0.0)
    solver = make_solver(*discs)
    place(solver, (30.0, 30.0), (30.0 + 14.0 + 1.5, 30.0))
    solver.advance_(2)
    for gap in (0.5, -3.0):
        with pytest.raises(ValueError, match=r"flow 1: bodies 0 .Cylinder. and 1 .Cylinder. overl"):
            place(solver, (30.0, 30.0), (30.0 + 14.0 + gap, 30.0))
    inside = Cylinder(diameter=8), Cylinder(diameter=40)  # outlines that are far apart
    for bodies in (inside, inside[::-1]):
        with pytest.raises(ValueError, match="overlap"):
            place(make_solver(*bodies), (40.0, 30.0), (42.0, 31.0))
    solver = make_solver(Fish(body_length=32), Ellipse(length=40, width=8))
    place(solver, (50.0, 30.0), (50.0, 45.0))
    with pytest.raises(ValueError, match=r"0 \(Fish\) and 1 \(Ellipse\) overlap"):
        place(solver, (50.0, 30.0), (50.0, 38.0), heading=0.5 * pi)


@pytest.mark.parametrize("at", [(6.0, 30.0), (94.5, 30.0), (50.0, 5.0), (50.0, 60.0)])
def test_a_body_that_reaches_beyond_the_grid_is_refused(at: tuple[float, float]) -> None:
    solver = make_solver(Cylinder(diameter=12, inset=0.0))
    with pytest.raises(
        ValueError, match=r"1: body 0 \(Cylinder\) reaches beyond .* x = 0\.5 to 98"
    ):
        place(solver, at)


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("skin", SKINS)
def test_readable_steps_refuse_the_places_that_a_reset_refuses(skin: Skin, levels: int) -> None:
    """Also too close to an edge for a patch around the body."""
    flow = FlowConfig(
        width=129, height=97, tau=0.8, bodies=(Cylinder(diameter=8),), skin=skin, levels=levels
    )
    solver, params = InPlaceSolver(config=flow, compile=False), make_params([flow])
    random, noted = torch.Generator().manual_seed(levels), []
    for place in torch.rand(16, 2, generator=random, dtype=torch.float64) * 160.0 - 20.0:
        body = place_body(*place.tolist())
        start = make_patches(FlowState(make_rest(flow, 1), (body,)), flow, params)
        reset = tell(partial(solver.reset_, torch.tensor([True]), body.position))
        assert tell(partial(simulate, start, flow, params, num_steps=2)) == reset
        noted.append(reset)
    assert len(set(noted)) == 2


def test_simulate_refuses_populations_of_another_grid_and_too_small_a_tau() -> None:
    flow = FlowConfig(width=48, height=40, tau=0.6)
    start, params = FlowState(make_rest(flow, 1)), make_params([flow])
    for wrong, message in (
        ({"state": FlowState(start.f[..., :30])}, r"f has shape \(1, 9, 40, 30\)"),
        ({"params": params._replace(tau=params.tau - 0.4)}, "tau = 0.2.* outside the validated"),
    ):
        given = {"state": start, "config": flow, "params": params, "num_steps": 2, **wrong}
        with pytest.raises(ValueError, match=message):
            simulate(**given)


def tell(call: Callable[[], object]) -> str:
    """Return the message with which a call is refused."""
    try:
        call()
    except ValueError as error:
        return str(error)
    return ""


def test_refused_start_changes_nothing_and_other_rows_are_ignored() -> None:
    solver = make_solver(Cylinder(diameter=12), Cylinder(diameter=16))
    place(solver, (25.0, 30.0), (65.0, 30.0))
    before = solver.state_dict()
    with pytest.raises(ValueError, match="overlap"):
        place(solver, (25.0, 30.0), (30.0, 30.0))
    assert all(torch.equal(value, before[name]) for name, value in solver.state_dict().items())
    nowhere = torch.full((2, 2, 2), torch.nan)
    nowhere[0] = torch.tensor([[30.0, 30.0], [60.0, 30.0]])
    solver.reset_(torch.tensor([True, False]), nowhere, torch.zeros(2, 2))
    assert solver.bodies[1].position.tolist() == [[60.0, 30.0], [65.0, 30.0]]


def test_several_bodies_need_a_place_before_they_move() -> None:
    solver = make_solver(Cylinder(diameter=12), Cylinder(diameter=16))
    with pytest.raises(ValueError, match="the 2 bodies overlap at the centre"):
        solver.advance_(2)
    with pytest.raises(ValueError, match="overlap"):
        solver.reset_(EVERY)
    other = make_solver(*solver.config.bodies)
    only_first = torch.tensor([True, False])
    solver.reset_(only_first, torch.tensor([[[25.0, 30.0], [65.0, 30.0]]] * 2))
    solver.advance_(2, only_first)
    with pytest.raises(ValueError, match="the 2 bodies overlap at the centre"):
        solver.advance_(2)
    place(solver, (25.0, 30.0), (65.0, 30.0))
    other.load_state_dict(solver.state_dict())
    other.advance_(2)


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize("edges", [PERIODIC, Boundaries(), Boundaries.make_stream()])
def test_body_that_crosses_an_edge_is_the_reason_given(
    skin: Skin, edges: Boundaries, caplog: pytest.LogCaptureFixture
) -> None:
    """With an immersed boundary the flow is not finite soon after."""
    body = Cylinder(diameter=8, motion=Driven(velocity=(0.25, -0.1)))
    flow = FlowConfig(
        width=24, height=24, tau=0.8, stream_speed=0.1, boundaries=edges, bodies=(body,), skin=skin
    )
    solver = InPlaceSolver(config=flow, num_envs=1, compile=False)
    for _ in range(4):
        solver.advance_(30)
    assert solver.is_diverged().all()
    (record,) = caplog.records
    assert record.message.startswith("flows [0] lose a body at an edge: keep its markers within x")


DRIVEN = Cylinder(diameter=8, motion=Driven(velocity=(0.2, 0.0)))


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize("motion", [Fixed(), Free()])
@pytest.mark.parametrize("num_steps", [20, 120])  # 24 nodes: right through a fixed one
def test_bodies_that_come_to_overlap_are_named_and_their_flow_is_lost(
    skin: Skin, motion: Motion, num_steps: int, caplog: pytest.LogCaptureFixture
) -> None:
    other = Cylinder(diameter=8, motion=motion, density_ratio=50.0)  # heavy: it is not swept away
    flow = FlowConfig(width=56, height=32, tau=0.8, bodies=(DRIVEN, other), skin=skin)
    solver = InPlaceSolver(config=flow, num_envs=2, compile=False)
    near, apart = [(12.0, 16.0), (23.0, 16.0)], [(12.0, 8.0), (23.0, 24.0)]
    solver.reset_(EVERY, torch.tensor([near, apart]))
    for _ in range(2 if num_steps == 20 else 1):  # the second time nothing more is said
        solver.advance_(num_steps)
    assert solver.is_diverged().tolist() == solver.overlaps.tolist() == [True, False]
    (record,) = caplog.records
    assert record.message.startswith("flows [0] have bodies that overlap")
    solver.reset_(EVERY, torch.tensor([apart, apart]))
    assert not solver.is_diverged().any()
