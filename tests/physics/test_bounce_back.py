"""Bounce-back at a body's skin: the links it cuts, its forces, and bodies that move."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from fishrl.physics import Cylinder, Fish, FlowConfig, FlowState
from fishrl.physics.bodies.motion import Driven, Free, Motion, Oscillating
from fishrl.physics.bodies.state import BodyState, make_body
from fishrl.physics.boundaries import Boundaries, NoSlip
from fishrl.physics.cases import PERIODIC
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import make_params, make_rest, make_uniform
from fishrl.physics.geometry import locate_markers
from fishrl.physics.lattice import CX, CY
from fishrl.physics.skins import BounceBack, ImmersedBoundary, Skin
from fishrl.physics.skins import links as links_module
from fishrl.physics.skins.links import AGAINST, ALONG, MARGIN, Links, to_links, to_markers
from tests.physics.flows import advance

SIZE = 64
MIDDLE = torch.tensor([[30.3, 29.6]], dtype=torch.float64)
ONE = torch.ones(1, dtype=torch.float64)


def make_cylinder(motion: Motion, **changes: object) -> FlowConfig:
    body = Cylinder(diameter=16, motion=motion)
    config = FlowConfig(
        width=SIZE, height=SIZE, tau=0.6, bodies=(body,), boundaries=PERIODIC, skin=BounceBack()
    )
    return replace(config, **changes)  # type: ignore[arg-type]


def draw_outline(seed: int) -> Tensor:
    """Return an outline ``[1, N, 2]``: a fish in mid-stroke or an ellipse, anywhere, any way."""
    torch.manual_seed(seed)
    x, y, angle, phase = torch.rand(4, 1, dtype=torch.float64).unbind()
    place = torch.stack((26 + 8 * x, 26 + 8 * y), -1)
    body = Fish(body_length=32, marker_spacing=0.5, thickness=0.3)
    if seed % 2:
        body = Cylinder(diameter=17, marker_spacing=0.5)
    state = make_body(place, 7 * angle, 0.01 * ONE)._replace(phase=7 * phase, beats=2 * ONE)
    return locate_markers(body.make_params(), state)


def find_links(outline: Tensor, width: int = SIZE, height: int = SIZE) -> Links:
    families = links_module.make_families(outline.device)
    counts, size = [outline.shape[1]], (width, height)
    return links_module.find_links(outline, counts, size, families, torch.float64)


def list_directions(links: Links) -> Tensor:
    """Return the number of each link's direction, ``[1, 4, N]``."""
    along, against = (torch.tensor(each)[:, None] for each in (ALONG, AGAINST))
    return torch.where(links.sign > 0, along, against)


def contains(outline: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Return whether points lie inside, by the angle under which they see the outline turn."""
    to = outline[0, :, None] - torch.stack((x, y), -1).double().view(-1, 2)
    after = to.roll(-1, 0)
    cross = to[..., 0] * after[..., 1] - to[..., 1] * after[..., 0]
    turn = torch.atan2(cross, (to * after).sum(-1)).sum(0).abs()
    return (turn > math.pi).view(x.shape)


@pytest.mark.parametrize("seed", range(12))
def test_an_outline_cuts_every_link_from_outside_to_inside_once(seed: int) -> None:
    outline = draw_outline(seed)
    links = find_links(outline)
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    inside = contains(outline, x, y)
    expected = set()
    for q, (cx, cy) in enumerate(zip(CX, CY, strict=True)):
        cut = ~inside & inside.roll((-cy, -cx), (0, 1))
        expected |= {(int(i), int(j), q) for j, i in cut.nonzero()}
    parts = links.x, links.y, list_directions(links)
    found = list(zip(*(part[links.sign != 0].tolist() for part in parts), strict=True))
    ends_inside = [inside[j + CY[q], i + CX[q]].item() for i, j, q in found]
    # a thin tail is cut on both sides of links that begin and end outside
    thick = [link for link, is_in in zip(found, ends_inside, strict=True) if is_in]
    assert len(thick) == len(set(thick))
    assert set(thick) == expected
    assert all(not inside[j, i] for i, j, _ in found)


@pytest.mark.parametrize("seed", range(4))
def test_a_link_meets_the_skin_where_its_crossing_is(seed: int) -> None:
    outline = draw_outline(seed)
    links = find_links(outline)
    q = list_directions(links)
    for axis, (node, c) in enumerate(((links.x, CX), (links.y, CY))):
        reached = node + links.fraction * torch.tensor(c)[q]
        crossing = to_links(outline[..., axis], links, [outline.shape[1]])
        error = torch.where(links.sign != 0, reached - crossing, 0.0)
        assert float(error.abs().max()) < 1e-9


def test_marker_forces_preserve_power_and_torque() -> None:
    torch.manual_seed(0)
    outline = draw_outline(0)
    links = find_links(outline)
    counts = [outline.shape[1]]
    force, speed = torch.rand(1, 4, *counts).double(), torch.rand(1, *counts).double()
    power = (force * to_links(speed, links, counts)).sum()
    assert float((to_markers(force, links, counts) * speed).sum()) == pytest.approx(float(power))


def find_inside(outline: Tensor) -> Tensor:
    """Return which nodes ``[Y, X]`` lie inside an outline ``[1, N, 2]``."""
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    return contains(outline, x, y)


@pytest.mark.parametrize("seed", range(12))
def test_each_node_that_changes_sides_is_passed_once(seed: int) -> None:
    before = draw_outline(seed)
    push = 0.1 * torch.rand(2, dtype=torch.float64)
    bend = 0.002 * (before[..., :1] - before.mean(1)[:, :1]) ** 2
    now = before + push + torch.cat((0.0 * bend, bend.clamp(max=0.2)), -1)
    counts = [before.shape[1]]
    passed = links_module.find_passed(before, now, counts, (SIZE, SIZE), torch.float64)
    change = torch.zeros(SIZE, SIZE, dtype=torch.float64)
    change.index_put_((passed.y[0], passed.x[0]), passed.turns[0], accumulate=True)
    expected = find_inside(now).double() - find_inside(before).double()
    assert int(expected.abs().sum()) > 2
    assert torch.equal(change, expected)


def test_a_swaying_cylinder_conserves_the_water_in_a_tank() -> None:
    """But for what the skin holds back for a few steps."""
    edges = Boundaries(left=NoSlip(), right=NoSlip(), bottom=NoSlip(), top=NoSlip())
    config = make_cylinder(Oscillating(sway=(8.0, 3.0)), boundaries=edges)
    params = make_params([config])
    body = make_body(MIDDLE, 0 * ONE, ONE / 800)
    state = FlowState(make_rest(config, 1), (body,))
    for _ in range(50):
        state = advance(state, config, 3, params)
        (body,) = state.bodies
        inside = find_inside(locate_markers(params.bodies[0], body))
        excess = float((state.f.sum(1)[0] * ~inside).sum())
        assert excess == pytest.approx(float(body.surplus), abs=1e-11)
    assert abs(excess) < 1e-4 * SIZE * SIZE


def carry(
    motion: Motion, velocity: tuple[float, float], num_steps: int, drho: float = 0.0
) -> FlowState:
    """Advance a body in water that moves with it."""
    config = make_cylinder(motion)
    none = torch.zeros(1, SIZE, SIZE, dtype=torch.float64)
    speed = torch.tensor([velocity], dtype=torch.float64)
    body = make_body(MIDDLE, 0.3 * ONE, 0.0 * ONE)._replace(velocity=speed)
    f = make_uniform(none + drho, none + speed[0, 0], none + speed[0, 1])
    return advance(FlowState(f, (body,)), config, num_steps)


@pytest.mark.parametrize(
    ("motion", "drho", "tolerance"),
    [
        (Driven(velocity=(0.07, -0.03)), 0.0, 1e-12),
        (Driven(velocity=(0.07, -0.03)), 0.02, 3e-4),
        (Free(), 0.0, 1e-4),
    ],
)
def test_body_in_a_uniform_stream_leaves_it(motion: Motion, drho: float, tolerance: float) -> None:
    """While its skin passes nodes: links, uncovered nodes and forces are Galilean invariant.

    The torque is but to the error of a sum over lattice lines, which turns a free body a little.
    Excess density is conserved, not its mean, and the number of nodes outside varies.
    """
    state = carry(motion, (0.07, -0.03), 60, drho)
    (body,) = state.bodies
    rho, ux, uy = compute_macroscopic(state.f.unbind(1))
    assert float((rho - drho).abs().max()) < tolerance
    assert float((ux - 0.07).abs().max() + (uy + 0.03).abs().max()) < tolerance
    assert float(body.hydro_force.abs().max()) < 10 * tolerance
    assert (body.position - MIDDLE)[0].tolist() == pytest.approx([4.2, -1.8], rel=tolerance)


def push(skin: Skin) -> BodyState:
    """Return a body as light as water that a load has pushed for a while."""
    cylinder = Cylinder(diameter=16, motion=Free())
    config = make_cylinder(Free(), skin=skin, bodies=(cylinder,))
    body = make_body(MIDDLE, 0.0 * ONE, 0.0 * ONE)
    body = body._replace(load=torch.tensor([[0.05, 0.02]], dtype=torch.float64))
    state = advance(FlowState(make_rest(config, 1), (body,)), config, 60)
    return state.bodies[0]


def test_pushed_body_obeys_newton_with_both_skins() -> None:
    """Added mass included: the water takes about half of the momentum."""
    body = push(BounceBack())
    area = math.pi * 64
    given = 60 * body.load + body.impulse
    torch.testing.assert_close(area * body.velocity, given, rtol=1e-3, atol=1e-4)
    assert 0.3 < float(body.velocity[0, 0]) * area / 3.0 < 0.7
    other = push(ImmersedBoundary())
    torch.testing.assert_close(body.velocity, other.velocity, rtol=0.1, atol=0.0)


def test_a_turning_cylinder_drags_the_water_as_stokes_second_problem() -> None:
    """Torque of a suddenly turning cylinder: 2 R^2 L U sqrt(pi mu rho / t), less 1.5 sqrt(nu t)/R.

    The layer is thin against R = 8; the impulse over 40 steps is compared, the first left out.
    """
    rate = 0.002
    config = make_cylinder(Driven(angular_velocity=rate), tau=0.53)
    nu, radius = config.nu, 8.0
    state = FlowState(make_rest(config, 1), (make_body(MIDDLE, 0 * ONE, 0 * ONE),))
    params = make_params([config])
    state = advance(state, config, 40, params)
    before = float(state.bodies[0].torque_impulse)
    state = advance(state, config, 160, params)
    got = float(state.bodies[0].torque_impulse) - before
    speed = rate * radius

    def impulse(t: float) -> float:
        """Flat wall, and the first correction for its curvature."""
        flat = 2.0 * speed * math.sqrt(nu * t / math.pi) + 1.5 * speed * nu * t / radius
        return 2.0 * math.pi * radius * radius * flat

    assert got == pytest.approx(impulse(200.0) - impulse(40.0), rel=0.03)


@pytest.mark.parametrize("corner", [(MARGIN, MARGIN), (SIZE - 1 - MARGIN, SIZE - 1 - MARGIN)])
def test_links_within_margin_are_on_grid(corner: tuple[float, float]) -> None:
    """Compared with a grid so large that no node is clamped."""
    low = torch.tensor(corner, dtype=torch.float64) == MARGIN
    for seed in range(12):
        outline = draw_outline(seed)
        edge = torch.where(low, outline.amin(1), outline.amax(1))
        inwards = torch.where(low, 1e-9, -1e-9)  # a placed outline lies within the margin
        outline = outline - edge + torch.tensor(corner, dtype=torch.float64) + inwards
        here, free = find_links(outline), find_links(outline + 100, 1000, 1000)
        for node, shifted in ((here.x, free.x), (here.y, free.y)):
            assert torch.equal(node[here.sign != 0], shifted[free.sign != 0] - 100)


def test_links_of_a_body_beyond_the_grid_stay_within_it() -> None:
    outline = draw_outline(1) + 1000.0
    for links in (find_links(outline), find_links(outline * math.nan)):
        assert isinstance(links, Links)
        for node in (links.x, links.y):
            assert int(node.min()) >= 2 and int(node.max()) <= SIZE - 3


def test_number_of_markers_is_a_multiple_of_the_skins() -> None:
    plain, rounded = (
        BounceBack(marker_multiple=n).fit(Cylinder(diameter=16)).num_markers for n in (1, 16)
    )
    assert rounded == -(-plain // 16) * 16 > plain
