"""Flows of a batch are read at points."""

import pytest
import torch

from fishrl.physics import FlowConfig, InPlaceSolver


def make_solver(flows_per_launch: int = 1) -> InPlaceSolver:
    config = FlowConfig(width=12, height=9, tau=0.6)
    solver = InPlaceSolver(
        config=config, num_envs=4, compile=False, flows_per_launch=flows_per_launch
    )
    generator = torch.Generator().manual_seed(0)
    solver.set_populations_(0.01 * torch.randn(4, 9, 9, 12, generator=generator))
    return solver


@pytest.mark.parametrize("flows_per_launch", [1, 2])
def test_at_a_node_the_flow_is_that_of_the_node(flows_per_launch: int) -> None:
    solver = make_solver(flows_per_launch)
    solver.advance_(2)
    points = torch.tensor([[3.0, 4.0], [11.0, 8.0], [0.0, 0.0]]).double().expand(4, 3, 2)
    density, velocity = solver.sample(points)
    rho, u = solver.macroscopic()
    x, y = points[0].long().unbind(-1)
    torch.testing.assert_close(density, rho[:, y, x], rtol=0, atol=1e-6)
    torch.testing.assert_close(velocity, u[:, :, y, x].mT, rtol=0, atol=1e-6)


def test_sampling_is_bilinear_and_clamped_to_grid() -> None:
    solver = make_solver()
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
