"""Levels: a flow refined around its bodies against uniform grids."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics import (
    Boundaries,
    Driven,
    Fish,
    FlowConfig,
    FlowState,
    Free,
    ImmersedBoundary,
    Patch,
    Scales,
    Sponge,
    simulate,
)
from fishrl.physics.cases import PERIODIC, make_swimmer_config
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import FlowParams, make_params, make_rest, make_uniform
from fishrl.physics.levels.grids import Grids, list_chains, make_patches, plan_levels
from fishrl.physics.levels.patch import RING
from fishrl.physics.levels.transfer import coarsen, fill, fill_all, restrict
from fishrl.physics.step import step
from tests.physics.flows import ONE, advance, place_body

SPEED = 0.07
SCALES = Scales(body_length=32, reynolds=800.0, period=360)


def make_box(num_nodes: int, tau: float, side: int, levels: int = 2) -> FlowConfig:
    """Return a periodic box of fine nodes with a patch that stays in its middle."""
    middle = (0.5 * num_nodes, 0.5 * num_nodes)
    patch = Patch(bodies=(), size=(side, side), centre=middle)
    return FlowConfig(
        width=num_nodes,
        height=num_nodes,
        tau=tau,
        boundaries=PERIODIC,
        levels=levels,
        patches=(patch,),
    )


def walk(
    state: FlowState, config: FlowConfig, params: FlowParams, random: torch.Generator
) -> FlowState:
    """Return the state after each patch of the root has moved at random, within its bounds."""
    grids = Grids(state, config, params)
    for chain in list_chains(grids.levels):
        for number in chain:
            grids.fill(number)
        origin, frame = grids.origins[chain[0]], grids.levels[chain[0]].frame
        by = torch.randint(-1, 2, origin.shape, generator=random)
        low, high = torch.tensor(frame.low), torch.tensor(frame.high)
        by = torch.where((origin + by >= low) & (origin + by <= high), by, 0)
        grids.move(chain, [by, *[torch.zeros_like(by)] * (len(chain) - 1)])
    return grids.collect()


def refine(state: FlowState, config: FlowConfig) -> FlowState:
    """Return a state with the patches of its configuration."""
    return make_patches(state, config, make_params([config] * len(state.f)))


def make_swimmer(length: int = 32, **changes: object) -> FlowConfig:
    """Return a free fish in a tank of 5 L x 3 L, or more for a small one."""
    scales = replace(SCALES, body_length=length, period=round(360 * length / 32))
    given = {"width": 161, "height": 97, "motion": Free()}
    return make_swimmer_config(scales, **given | changes)


@pytest.mark.parametrize(("width", "height"), [(31, 25), (9, 17), (17, 9), (9, 9)])
def test_ring_and_parent_take_what_the_other_has_there(width: int, height: int) -> None:
    random = torch.Generator().manual_seed(width)
    patch, parent = (
        0.01 * torch.randn(2, 9, *size, dtype=torch.float64, generator=random)
        for size in ((height, width), (30, 40))
    )
    origin, tau = torch.tensor([[5, 7], [12, 3]]), torch.tensor([0.6, 0.7], dtype=torch.float64)
    filled, whole = (
        fill(patch, parent, origin, tau),
        fill_all((width, height), parent, origin, tau),
    )
    ring = torch.ones(height, width, dtype=torch.bool)
    ring[2:-2, 2:-2] = False
    assert (filled - whole)[..., ring].abs().max() < 1e-16
    assert torch.equal(filled[..., ~ring], patch[..., ~ring])
    same = restrict(parent, whole, origin, tau)
    assert (same - parent).abs().max() < 1e-16
    changed = restrict(parent, patch, origin, tau) != parent
    for row, (x, y) in enumerate(origin.tolist()):
        own = slice(y + 2, y + height // 2 - 1), slice(x + 2, x + width // 2 - 1)
        assert changed[row, :, *own].all()
    assert changed.sum() == 2 * 9 * (height // 2 - 3) * (width // 2 - 3)


@pytest.mark.parametrize("levels", [2, 3])
def test_uniform_flow_stays_uniform_while_patches_walk_at_random(levels):
    config = make_box(160, 0.52, 40, levels)
    params = make_params([config] * 2)
    one = torch.ones(2, 1, 1, dtype=torch.float64)
    given = make_uniform(0.01 * one, 0.05 * one, -0.03 * one)
    width, height = config.coarsest_size
    state = refine(FlowState(given.expand(-1, -1, height, width)), config)
    random = torch.Generator().manual_seed(1)
    for _ in range(10):
        state = step(walk(state, config, params, random), config, params)
    for f in (state.f, *(patch.f for patch in state.patches)):
        assert (f - given).abs().max() < 1e-16


def make_fields(kind: str, num_nodes: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return rho - 1 and velocity of a flow in a periodic box."""
    at = torch.arange(num_nodes, dtype=torch.float64) / num_nodes
    y, x = torch.meshgrid(at, at, indexing="ij")
    k = 2.0 * math.pi
    if kind == "shear wave":
        return 0.0 * x, 0.0 * x, SPEED * torch.sin(k * x)
    if kind == "Taylor-Green":
        p = 0.75 * SPEED**2 * (torch.cos(2.0 * k * x) + torch.cos(2.0 * k * y))
        ux, uy = torch.sin(k * x) * torch.cos(k * y), -torch.cos(k * x) * torch.sin(k * y)
        return p, SPEED * ux, SPEED * uy
    # a Gaussian vortex that a stream carries into the patch
    radius, speed, dx, dy = 0.1, 0.7 * SPEED, x - 0.2, y - 0.5
    square = (dx * dx + dy * dy) / radius**2
    swirl = speed * torch.exp(0.5 * (1.0 - square)) / radius
    return -1.5 * speed**2 * torch.exp(1.0 - square), speed - swirl * dy, swirl * dx


# Factors: what is as smooth outside as inside gains nothing, and the interface adds its own error.
@pytest.mark.parametrize(
    ("kind", "reynolds", "walks", "touches", "factor"),
    [
        ("vortex", 1000.0, True, False, 1.1),
        ("vortex", 1000.0, False, True, 1.1),
        ("shear wave", 125.0, False, False, 1.5),
        ("Taylor-Green", 125.0, True, False, 3.0),
    ],
)
def test_patches_add_little_to_the_error_of_the_coarse_grid(kind, reynolds, walks, touches, factor):
    """Two that touch lie above each other, with their common side in the middle of the vortex."""
    num, side = 48, 24
    refined = make_box(num, 3.0 * SPEED * num / reynolds + 0.5, side)
    if touches:
        height = side // 2
        boxes = [Patch.between((12, low), (36, low + height)) for low in (12, 12 + height)]
        refined = replace(refined, patches=tuple(replace(box, bodies=()) for box in boxes))
    fine = replace(refined, levels=1, patches=())
    coarse = replace(fine, width=num // 2, height=num // 2, tau=0.5 * (fine.tau + 0.5))
    params = make_params([refined])
    exact = advance(FlowState(make_uniform(*(v[None] for v in make_fields(kind, num)))), fine, 10)
    start = torch.stack(coarsen(exact.f[..., ::2, ::2].unbind(1), params.tau), 1)
    state, without = refine(FlowState(start), refined), FlowState(start)
    inside = []
    for patch in state.patches:
        (x, y), (height, width) = (2 * patch.origin[0]).tolist(), patch.f.shape[2:]
        inside.append(patch._replace(f=exact.f[..., y : y + height, x : x + width]))
    state = state._replace(patches=tuple(inside))
    random = torch.Generator().manual_seed(3)
    errors, own = [], []
    for _ in range(5):
        for _ in range(20):
            moved = walk(state, refined, params, random) if walks else state
            state = step(moved, refined, params)
        exact, without = advance(exact, fine, 40), advance(without, coarse, 20)
        _, *true = compute_macroscopic(exact.f[..., ::2, ::2].unbind(1))
        for flow, noted in ((state, errors), (without, own)):
            _, *u = compute_macroscopic(flow.f.unbind(1))
            noted.append(sum(((a - b) ** 2).mean() for a, b in zip(u, true, strict=True)))
    assert max(errors) ** 0.5 < factor * max(own) ** 0.5


def test_free_swimmer_on_two_levels_swims_as_on_the_fine_grid_alone():
    speeds = []
    for length, levels in ((32, 1), (32, 2), (16, 1)):
        size = {"width": 5 * length + 1, "height": 3 * length + 1}
        config = make_swimmer(length, levels=levels, **size)
        params = make_params([config])
        scale = length / 32
        fish = place_body(115.2 * scale, 48.0 * scale, math.pi, 1.0 / (360 * scale))
        state = FlowState(make_rest(config, 1, torch.float32), (fish,), 0.0 * ONE)
        state = refine(state, config) if levels > 1 else state
        state = advance(state, config, round(120 * scale) // levels, params)
        speeds.append(float(-state.bodies[0].velocity[0, 0]))
    fine, refined, coarse = speeds
    assert abs(refined / fine - 1.0) < 0.003  # the trials: 0.1 % at L = 64
    assert abs(coarse / fine - 1.0) > 0.03


def test_rows_of_a_batch_do_not_know_of_each_other():
    config = make_swimmer(16, levels=2)
    configs = [config, replace(config, tau=config.tau + 0.01)]
    one, pair = torch.ones(1, dtype=torch.float64), torch.ones(2, dtype=torch.float64)
    together, num_steps = make_params(configs), 25
    fish = place_body(57.6, 24.0, math.pi, 1.0 / 180)
    other = place_body(30.0, 23.0, 0.0, 1.5 / 180)
    both = type(fish)(*(torch.cat(parts) for parts in zip(fish, other, strict=True)))
    state = FlowState(make_rest(config, 2), (both,), 0.0 * pair)
    state = advance(make_patches(state, config, together), config, num_steps, together)
    assert (state.patches[0].origin[0] != state.patches[0].origin[1]).any()
    for row, (own, start) in enumerate(zip(configs, (fish, other), strict=True)):
        params = make_params([own])
        alone = make_patches(FlowState(make_rest(own, 1), (start,), 0.0 * one), own, params)
        alone = advance(alone, own, num_steps, params)
        pairs = zip(pytree.tree_leaves(alone), pytree.tree_leaves(state), strict=True)
        assert all(torch.equal(a[0], b[row]) for a, b in pairs if a is not None)


def test_gradients_of_a_beat_with_shifts_equal_central_differences():
    config = make_swimmer(16, levels=2, skin=ImmersedBoundary(), motion=Free())
    params = make_params([config])

    def swim(values: Tensor) -> Tensor:
        frequency, tau, x = values.unbind()
        fish = place_body(0.0, 24.3, math.pi)
        fish = fish._replace(
            position=torch.stack((x, torch.full_like(x, 24.3)))[None],
            frequency=frequency[None] / 180,
        )
        own = params._replace(tau=tau[None])
        still = torch.zeros(1, 49, 81, dtype=torch.float64)
        state = FlowState(make_uniform(still, still - 0.15, still), (fish,), 0.0 * ONE)
        state = make_patches(state, config, own)
        start = state.patches[0].origin
        with pytest.raises(ValueError, match=r"interval = 1: .* that of 2"):
            simulate(state, config, own, num_steps=90, interval=1)
        state, _ = simulate(state, config, own, num_steps=90)
        assert (state.patches[0].origin != start).any()
        return state.bodies[0].position[0, 1] + state.bodies[0].work[0]

    at = torch.tensor([1.5, config.tau, 80.2], dtype=torch.float64)
    (exact,) = torch.autograd.grad(swim(at.requires_grad_()), at)
    change = 1e-8 / exact.abs()  # all three count alike
    with torch.no_grad():
        difference = 0.5 * (swim(at + change) - swim(at - change))
    torch.testing.assert_close((exact * change).sum(), difference, rtol=1e-4, atol=0.0)


def test_patch_stops_before_an_edge_and_the_flow_stays_finite():
    config = make_swimmer(16, levels=2, motion=Driven(velocity=(0.0, 0.2)))
    fish = place_body(80.0, 48.0, math.pi, 1.0 / 180)
    state = refine(FlowState(make_rest(config, 1), (fish,), 0.0 * ONE), config)
    state = advance(state, config, 70)
    _, level = plan_levels(config)
    assert int(state.patches[0].origin[0, 1]) == level.frame.high[1]
    assert state.f.isfinite().all()


def test_patch_stops_at_the_end_of_its_box_and_its_fish_swims_on():
    box = ((70.0, 0.0), (160.0, 96.0))
    patch = Patch(within=box)
    config = make_swimmer(16, levels=2, motion=Driven(velocity=(-0.2, 0.0)), patches=(patch,))
    fish = place_body(108.0, 48.0, math.pi, 1.0 / 180)
    state = refine(FlowState(make_rest(config, 1), (fish,), 0.0 * ONE), config)
    before = state.patches[0].origin
    state = advance(state, config, 50)
    assert before.tolist() != state.patches[0].origin.tolist() == [[35, 12]]
    assert state.f.isfinite().all()


def test_stream_enters_at_the_speed_of_one_level():
    config = FlowConfig(
        width=97,
        height=97,
        tau=0.6,
        boundaries=Boundaries.make_stream(),
        stream_speed=0.05,
        ramp_steps=100,
        levels=2,
        patches=(Patch(bodies=(), size=(24, 24), centre=(48, 48)),),
    )
    speeds = []
    for own in (replace(config, levels=1), config):
        state = FlowState(make_rest(own, 1), (), 0.0 * ONE)
        state = refine(state, own) if own.levels > 1 else state
        state = advance(state, own, 60 // own.levels)
        assert state.clock.tolist() == [60.0]
        middle = state.f[:, :, state.f.shape[2] // 2, 0]
        speeds.append(float(compute_macroscopic(middle.unbind(1)).ux))
    assert math.isclose(*speeds, rel_tol=1e-12)


FISH = Fish(body_length=16)


@pytest.mark.parametrize("levels", [2, 3, 4])
def test_patch_that_stays_ends_where_bodies_must(levels):
    config = FlowConfig(
        width=321,
        height=161,
        tau=0.6,
        bodies=(FISH, FISH),
        levels=levels,
        sponges=(Sponge(length=24),),
        patches=(Patch.between((-50.0, -50.0), (999.0, 999.0)),),
    )
    (patch,), reach = config.refined, RING + config.skin.margin
    low, high = (
        [c + sign * 0.5 * s for c, s in zip(patch.centre, patch.size, strict=True)]
        for sign in (-1, 1)
    )
    assert patch.bodies == (0, 1)
    assert [n + reach for n in low] == list(config.body_bounds[0])
    assert [n - reach for n in high] == list(config.body_bounds[1])
    assert config.edges == ((0, 0), (320 - 24, 160))
    for outside in (Patch.between((310.0, 0.0), (320.0, 50.0)), Patch(centre=(999.0, 50.0))):
        with pytest.raises(ValueError, match="away from edges and sponges"):
            replace(config, patches=(outside,)).list_grids()
