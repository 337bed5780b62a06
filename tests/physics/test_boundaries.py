"""Edges that move, sound that leaves, and profiles along edges."""

import pytest
import torch
from torch.testing import assert_close

from fishrl.physics.boundaries import (
    Boundaries,
    NonEquilibrium,
    NoSlip,
    OpenEdge,
    Periodic,
    Profile,
    Side,
)
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.diagnostics import compute_vorticity
from fishrl.physics.flow import FlowConfig, FlowState, make_uniform
from tests.physics.flows import advance, start_stream


@pytest.mark.parametrize("top", [NoSlip(velocity=(1.0, 0.0)), NonEquilibrium(velocity=(1.0, 0.0))])
def test_sliding_wall_drives_an_exact_couette_flow(top: NoSlip | NonEquilibrium) -> None:
    """u = U y / H, H from wall to wall: a linear profile is met to round-off."""
    edges = Boundaries(left=Periodic(), right=Periodic(), bottom=NoSlip(), top=top)
    config = FlowConfig(width=4, height=8, tau=0.9, stream_speed=0.05, boundaries=edges)
    state = advance(start_stream(config), config, 650)
    u = compute_macroscopic(state.f.unbind(1)).ux[0, :, 1]
    gap = 8.0 if isinstance(top, NoSlip) else 7.5
    exact = 0.05 * (torch.arange(8, dtype=torch.float64) + 0.5) / gap
    assert_close(u, exact, rtol=0, atol=1e-6)


def test_open_edge_transmits_and_pinned_edge_reflects_sound() -> None:
    """A plane pulse of density 1e-3 meets the right edge; 4 % of it returns from the open one."""
    left = {}
    for name, right in {"open": OpenEdge(), "pinned": NonEquilibrium(density=1.0)}.items():
        edges = Boundaries(
            left=NonEquilibrium(velocity=(1.0, 0.0)), right=right, bottom=Periodic(), top=Periodic()
        )
        config = FlowConfig(width=200, height=4, tau=0.6, stream_speed=0.05, boundaries=edges)
        x = torch.arange(200, dtype=torch.float64).expand(1, 4, 200)
        pulse = 1e-3 * torch.exp(-(((x - 100) / 10) ** 2))
        # only the wave that runs to the right: u' = c_s rho'
        f = make_uniform(pulse, 0.05 + pulse / 3**0.5, 0.0 * pulse)
        state = advance(FlowState(f), config, 260)
        drho, _, _ = compute_macroscopic(state.f.unbind(1))
        left[name] = float(drho[0, :, 10:150].abs().max())
    assert left["open"] < 6e-5 < 3e-4 < left["pinned"]


def test_profiles_span_the_walls_at_their_ends() -> None:
    walls = Boundaries(
        left=NonEquilibrium(velocity=(1.0, 0.0), profile=Profile.PARABOLA),
        bottom=NoSlip(),
        top=NoSlip(),
    )
    parabola = walls.evaluate_profile(Side.LEFT, 8)[1:-1]
    s = (torch.arange(8, dtype=torch.float64) + 0.5) / 8
    assert_close(parabola, 4 * s * (1 - s))
    shear = Boundaries(left=NonEquilibrium(velocity=(1.0, 0.0), profile=Profile.SHEAR))
    assert_close(shear.evaluate_profile(Side.LEFT, 5)[1:-1], torch.linspace(-1, 1, 5).double())


def test_vortex_leaves_a_stream_whose_edges_make_no_vorticity() -> None:
    """A Taylor vortex leaves at the outflow and another passes a side: 2 % and less remains."""
    size, speed = 64, 0.1
    edges = Boundaries.make_stream()
    config = FlowConfig(width=size, height=size, tau=0.53, stream_speed=speed, boundaries=edges)
    y, x = torch.meshgrid(torch.arange(size).double(), torch.arange(size).double(), indexing="ij")
    x, y = (x - 44.0) / 6.0, (y - 0.5 * (size - 1)) / 6.0
    decay = 0.03 * torch.exp(0.5 * (1.0 - x * x - y * y))
    drho, u, v = -1.5 * decay * decay, speed - y * decay, x * decay
    state = FlowState(make_uniform(drho[None], u[None], v[None]))
    vorticity = []
    for each in (state, advance(state, config, 600)):  # 40 nodes past the outflow
        _, ux, uy = compute_macroscopic(each.f.unbind(1))
        vorticity.append(float(compute_vorticity(torch.stack((ux, uy), 1)).abs().max()))
    assert vorticity[1] < 0.02 * vorticity[0]


def test_uniform_stream_between_its_edges_is_steady() -> None:
    edges = Boundaries.make_stream()
    config = FlowConfig(width=20, height=12, tau=0.51, stream_speed=0.1, boundaries=edges)
    start = start_stream(config, velocity=(0.1, 0.0))
    assert_close(advance(start, config, 50).f, start.f, rtol=0.0, atol=1e-15)
    assert config.inflow == (1.0, 0.0)
    assert config.fastest_edge == pytest.approx(0.1)
