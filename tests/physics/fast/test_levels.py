"""Levels in place: the same numbers as readable steps, and all that a solver reads and restores."""

import math
from typing import Any

import pytest
import torch

from fishrl.physics import (
    BounceBack,
    Boundaries,
    Cylinder,
    Driven,
    Fish,
    FlowConfig,
    Free,
    ImmersedBoundary,
    InPlaceSolver,
    Patch,
    Scales,
    Skin,
    Sponge,
)
from fishrl.physics.flow import FlowState, make_params, make_rest, make_uniform
from fishrl.physics.levels.grids import make_patches
from tests.physics.flows import advance, read_bodies, start_solver

TAU = Scales(body_length=16, reynolds=400.0, period=184).tau
FISH = Fish(body_length=16, motion=Free())
TOGETHER = Patch(bodies=(0, 1), size=(90, 60), centre=(80.0, 48.0))


def make_config(**changes: Any) -> FlowConfig:
    given = {"width": 161, "height": 97, "tau": TAU, "bodies": (FISH,), "levels": 2}
    return FlowConfig(**given | changes)


def start(config: FlowConfig, num_envs: int = 1, **settings: Any) -> InPlaceSolver:
    """Return a solver whose fish swims fast enough for patches to move at once."""
    steps = torch.arange(num_envs, dtype=torch.float64)[:, None]
    first = torch.tensor([[80.3, 0.5 * config.height]], dtype=torch.float64)
    places = [first - torch.cat((7.0 * steps, 0.0 * steps), 1)]
    places += [places[0] + torch.tensor([[20.0, 0.5]])] * (len(config.bodies) - 1)
    heading = math.pi - 0.4 * steps.expand(-1, len(config.bodies))
    solver = start_solver(config, torch.stack(places, 1), heading, frequency=1.5 / 184, **settings)
    solver.body.velocity.copy_(torch.tensor([[-0.2, 0.1]]))
    return solver


def read(solver: InPlaceSolver) -> FlowState:
    """Return the state of a solver at rest for readable steps."""
    bodies, clock = read_bodies(solver), torch.zeros(solver.num_envs, dtype=torch.float64)
    state = FlowState(make_rest(solver.config, solver.num_envs), bodies, clock)
    return make_patches(state, solver.config, make_params(solver.configs))


@pytest.mark.parametrize(
    ("changes", "skin"),
    [
        ({}, BounceBack()),
        ({}, ImmersedBoundary()),
        ({"levels": 3, "width": 257, "height": 193}, BounceBack()),
        ({"bodies": (FISH, Cylinder(diameter=10)), "patches": (TOGETHER,)}, BounceBack()),
        (
            {
                "boundaries": Boundaries.make_stream(),
                "stream_speed": 0.05,
                "ramp_steps": 30,
                "sponges": (Sponge(length=20),),
            },
            BounceBack(),
        ),
    ],
)
def test_levels_in_place_equal_readable_steps(changes: dict[str, Any], skin: Skin) -> None:
    config = make_config(**changes, skin=skin)
    solver = start(config, 2)
    exact = read(solver)
    origin = exact.patches[0].origin
    solver.advance_(6 * 2**config.levels)
    exact = advance(exact, config, 12)
    root, patch, *_ = solver._batch.grids
    can_move = isinstance(skin, BounceBack) and not config.patches
    assert bool((exact.patches[0].origin != origin).any()) == can_move
    assert torch.equal(patch.origin, exact.patches[0].origin)
    assert (root.populations() - exact.f).abs().max() < 2e-7
    inside = [f[..., 2:-2, 2:-2] for f in (patch.populations(), exact.patches[0].f)]
    assert (inside[0] - inside[1]).abs().max() < 2e-7
    for body, expected in zip(solver.bodies, exact.bodies, strict=True):
        torch.testing.assert_close(body.position, expected.position, rtol=0.0, atol=1e-5)
        torch.testing.assert_close(body.work, expected.work, rtol=1e-4, atol=1e-6)
        torch.testing.assert_close(body.impulse, expected.impulse, rtol=1e-3, atol=1e-5)
    assert not solver.is_diverged().any()


def test_restored_flows_continue_bit_for_bit_in_this_process_or_another() -> None:
    config = make_config()
    first = start(config, 2)
    first.advance_(40)
    saved = first.state_dict()
    first.advance_(40)
    for settings in ({}, {"num_workers": 1}, {"flows_per_launch": 2}):
        second = start(config, 2, **settings)
        second.load_state_dict(saved)
        second.advance_(40)
        pairs = zip(first.state_dict().items(), second.state_dict().values(), strict=True)
        assert [name for (name, one), other in pairs if not torch.equal(one, other)] == []
        second.close()


def test_only_chosen_rows_advance() -> None:
    solver = start(make_config(), 2)
    solver.advance_(40)
    before, rows = solver.state_dict(), torch.tensor([True, False])
    solver.advance_(8, rows)
    for name, value in solver.state_dict().items():
        assert torch.equal(value[1], before[name][1]), name
    assert solver._batch.flow.clock.tolist() == [48.0, 40.0]
    for second, both in zip(solver.macroscopic(~rows), solver.macroscopic(), strict=True):
        assert torch.equal(second, both[1:]) and not torch.equal(both[:1], both[1:])


def test_fields_and_samples_agree_on_all_levels() -> None:
    solver = start(make_config())
    solver.advance_(80)
    rho, u = solver.macroscopic()
    assert rho.shape == (1, 97, 161) and u.shape == (1, 2, 97, 161)
    nodes = torch.tensor([[[80, 60], [20, 10], [85, 48], [150, 90]]])
    x, y = nodes[0].unbind(-1)
    at, speed = solver.sample(nodes.double())
    torch.testing.assert_close(at[0], rho[0, y, x])
    torch.testing.assert_close(speed[0], u[0, :, y, x].T)
    assert solver.sample(torch.full((1, 1, 2), torch.nan))[0].isnan().all()


@pytest.mark.parametrize("levels", [2, 3])
def test_vorticity_of_a_parabola_is_exact_across_levels_up_to_the_skin(levels: int) -> None:
    """Central differences of a parabola are; those of values between coarse nodes are not."""
    solver = start(make_config(levels=levels, width=193, height=193))
    filled = []
    for number, (width, height, spacing) in enumerate(solver.config.list_grids()):
        y = solver.corners[0, number, 1] + spacing * torch.arange(height, dtype=torch.float64)
        ux = (1e-6 * (y - 90.0) ** 2)[None, :, None].expand(1, height, width)
        filled.append(make_uniform(0.0 * ux, ux, 0.0 * ux).float())
    solver.set_populations_(filled)
    water = solver.find_water()
    exact = -2e-6 * (torch.arange(193.0) - 90.0)[None, :, None].expand(1, 193, 193)
    near = slice(2**levels, -(2**levels))  # differences at edges are one-sided
    for is_water in (None, water):
        found = solver.vorticity(is_water=is_water)
        known = torch.ones_like(water) if is_water is None else ~found.isnan()
        assert (known == water).all() or is_water is None
        error = (found - exact).where(known, 0.0).abs()[:, near, near]
        at_skin = 1e-6 if is_water is not None else 0.0  # one-sided, a node
        assert error.max() < 2e-9 + at_skin and error.median() < 2e-9


def test_bodies_beyond_their_patch_are_refused_and_end_their_flow() -> None:
    box = Patch(bodies=(0,), size=(60, 60), centre=(80.0, 48.0))
    solver = start(make_config(patches=(box,)))
    assert not solver.is_diverged().any()
    solver.body.position[0, 0] -= 30.0
    assert solver.is_diverged().all()
    with pytest.raises(ValueError, match="a body is not within its patch"):
        solver.reset_(torch.ones(1, dtype=torch.bool), torch.tensor([[50.0, 48.0]]))


def test_reset_puts_patches_around_the_new_place() -> None:
    solver = start(make_config(), 2)
    solver.advance_(40)
    before = solver._batch.grids[1].origin.clone()
    rows = torch.tensor([False, True])
    solver.reset_(rows, torch.tensor([[0.0, 0.0], [100.0, 40.0]]), torch.zeros(2))
    origin = solver._batch.grids[1].origin
    assert torch.equal(origin[0], before[0]) and not torch.equal(origin[1], before[1])
    solver.advance_(8)
    assert not solver.is_diverged().any()


STREAM = {"boundaries": Boundaries.make_stream(), "stream_speed": 0.05}


def test_flow_continues_bit_for_bit_from_its_populations() -> None:
    """Row 0 continues where row 1 of another solver was, which stays."""
    config = make_config(**STREAM, bodies=(FISH, Cylinder(diameter=10)), patches=(TOGETHER,))
    first, second = start(config, 2), start(config, 2, flows_per_launch=2)
    first.advance_(20)
    rows, every = torch.tensor([True, False]), range(len(config.list_grids()))
    f = [first.populations(grid)[1:] for grid in every]
    before = second.state_dict()
    second.set_populations_(f, rows)
    for body, own in zip(first.bodies, second.bodies, strict=True):
        for value, target in zip(body, own, strict=True):
            target[0] = value[1]
    for name, value in second.state_dict().items():
        assert torch.equal(value[1:], before[name][1:]), name
    for solver in (first, second):
        solver.advance_(8)
    for grid in every:
        assert torch.equal(second.populations(grid)[0], first.populations(grid)[1])
    for body, own in zip(first.bodies, second.bodies, strict=True):
        assert all(torch.equal(a[1], b[0]) for a, b in zip(body, own, strict=True))
    second.close()


@pytest.mark.compile
@pytest.mark.parametrize(
    "bodies", [(), pytest.param((FISH,), marks=pytest.mark.slow)], ids=["no body", "fish"]
)
def test_compiled_levels_equal_eager_ones_also_when_loaded(bodies: tuple[Fish, ...]) -> None:
    """Water that begins to move in a tank sends waves through a patch near its corner."""
    still = Patch(bodies=(), size=(40, 32), centre=(32.0, 28.0))
    given = {} if bodies else {"patches": (still,), "stream_speed": 0.05}
    config = make_config(bodies=bodies, **given)
    compiled, loaded, eager = (
        InPlaceSolver(config=config, compile=compile, num_workers=0)
        if not bodies
        else start(config, compile=compile)
        for compile in (True, True, False)
    )
    for solver in (compiled, loaded, eager):
        if not bodies:
            solver.reset_(torch.tensor([True]), velocity=(1.0, 0.5))
        solver.advance_(40)
    expected, same = eager.state_dict(), loaded.state_dict()
    for name, value in compiled.state_dict().items():
        torch.testing.assert_close(value, expected[name], rtol=1e-4, atol=2e-6, msg=name)
        assert torch.equal(value, same[name]), name


BOXED = Patch(within=((60.0, 0.0), (160.0, 96.0)))


@pytest.mark.parametrize(
    ("velocities", "places", "patches"),
    [
        ((-0.2,), (100.0,), (BOXED,)),
        ((0.1, -0.1), (50.0, 110.0), ()),
        ((0.0,), (), (Patch(size=(40, 40), centre=(40.0, 48.0)),)),
    ],
    ids=["out of its box", "patches that meet", "never placed"],
)
def test_patch_that_loses_its_body_is_the_reason_given(
    velocities: tuple[float, ...],
    places: tuple[float, ...],
    patches: tuple[Patch, ...],
    caplog: pytest.LogCaptureFixture,
) -> None:
    bodies = tuple(Cylinder(diameter=10, motion=Driven(velocity=(v, 0.0))) for v in velocities)
    config = make_config(tau=0.6, bodies=bodies, patches=patches)
    solver = InPlaceSolver(config=config, num_envs=1, compile=False, num_workers=0)
    if places:
        middle = [[[x, 0.5 * (config.height - 1)] for x in places]]
        solver.reset_(torch.tensor([True]), torch.tensor(middle, dtype=torch.float64))
    for _ in range(4):
        solver.advance_(64)
    (record,) = caplog.records
    assert record.message.startswith("flows [0] have bodies outside their patches, or patches")
