"""A stream that changes smoothly accelerates all of the water, without a shock."""

import pytest
import torch

from fishrl.physics import FlowConfig, InPlaceSolver
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge


def test_a_smooth_change_sends_no_shock_and_ends_in_the_uniform_stream() -> None:
    """At once, the density jumps by rho dU / c_s (Joukowsky 1898), as water in a pipe does."""
    stream = NonEquilibrium(velocity=(1.0, 0.0))
    edges = Boundaries(left=stream, right=OpenEdge(), bottom=stream, top=stream)
    config = FlowConfig(width=40, height=24, tau=0.6, stream_speed=0.06, boundaries=edges)
    solver = InPlaceSolver(config=config, num_envs=2, compile=False, num_workers=0)
    solver.reset_(torch.ones(2, dtype=torch.bool), velocity=(1.0, 0.0))
    with pytest.raises(ValueError, match=r"imposes 0\.400 nodes per step, allowed is 0\.3"):
        solver.set_stream_speed_(torch.tensor([0.05, 0.4]))
    faster = torch.full((2,), 0.09, dtype=torch.float64)
    transit = 40 * 3.0**0.5  # of sound, steps
    solver.set_stream_speed_(faster, torch.tensor([True, False]), num_steps=round(4 * transit))
    solver.set_stream_speed_(faster, torch.tensor([False, True]), num_steps=0)
    densities, masses = [], []
    for _ in range(60):
        solver.advance_(10)
        rho, velocity = solver.macroscopic()
        densities.append((rho - 1.0).abs().amax((1, 2)))
        masses.append((rho.double() - 1.0).mean((1, 2)))
    smooth, sudden = torch.stack(densities).amax(0).tolist()
    assert sudden == pytest.approx(0.03 * 3.0**0.5, rel=0.05)
    assert smooth < 0.45 * sudden
    gained = torch.stack(masses)
    assert gained[:, 0].abs().max() < 0.45 * gained[:, 1].abs().max()
    assert gained[-1].abs().max() < 1e-4
    uniform = torch.tensor([0.09, 0.0])[:, None, None].expand_as(velocity)
    torch.testing.assert_close(velocity, uniform, rtol=0, atol=5e-4)


def test_a_speed_that_is_set_at_once_ends_a_change_under_way_but_not_the_rise_from_rest() -> None:
    config = FlowConfig(width=16, height=8, tau=0.6, stream_speed=0.06, ramp_steps=100)
    solver = InPlaceSolver(config=config, num_envs=2, compile=False, num_workers=0)
    slower, second = torch.full((2,), 0.02, dtype=torch.float64), torch.tensor([False, True])
    solver.advance_(10)
    solver.set_stream_speed_(slower, second, num_steps=80)
    solver.advance_(40)
    solver.set_stream_speed_(2.0 * slower)
    torch.testing.assert_close(solver.stream_speed, torch.tensor([0.02, 0.04]).double())
