"""Flows of a batch: reading them at points, and bodies that differ from flow to flow."""

import pytest
import torch

from fishrl.physics import DCylinder, FlowConfig, InPlaceSolver, Storage
from fishrl.physics.boundaries import Boundaries, NonEquilibrium
from fishrl.physics.flow import make_params


def make_solver(storage: Storage = Storage.FLOAT32, flows_per_launch: int = 1) -> InPlaceSolver:
    config = FlowConfig(width=12, height=9, tau=0.6, storage=storage)
    solver = InPlaceSolver(
        config=config, num_envs=4, compile=False, flows_per_launch=flows_per_launch
    )
    generator = torch.Generator().manual_seed(0)
    solver.set_populations_(0.01 * torch.randn(4, 9, 9, 12, generator=generator))
    return solver


@pytest.mark.parametrize("storage", Storage, ids=lambda s: s.name)
@pytest.mark.parametrize("flows_per_launch", [1, 2])
def test_at_a_node_the_flow_is_that_of_the_node(storage: Storage, flows_per_launch: int) -> None:
    solver = make_solver(storage, flows_per_launch)
    solver.advance_(2)
    points = torch.tensor([[3.0, 4.0], [11.0, 8.0], [0.0, 0.0]]).double().expand(4, 3, 2)
    density, velocity = solver.sample(points)
    rho, u = solver.macroscopic()
    x, y = points[0].long().unbind(-1)
    torch.testing.assert_close(density, rho[:, y, x], rtol=0, atol=1e-6)
    torch.testing.assert_close(velocity, u[:, :, y, x].mT, rtol=0, atol=1e-6)


def test_between_nodes_the_flow_is_bilinear_and_outside_the_grid_that_of_the_edge() -> None:
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


def test_bodies_of_different_size_in_one_batch_have_the_drag_they_have_alone() -> None:
    """Also of the same solver, before it got the big disc in one row."""
    stream = NonEquilibrium(velocity=(1.0, 0.0))
    edges = Boundaries(left=stream, right=stream, bottom=stream, top=stream)
    flow = {"width": 48, "height": 40, "tau": 0.6, "stream_speed": 0.05, "boundaries": edges}
    big = DCylinder(diameter=16)
    small = DCylinder(diameter=9, num_markers=big.num_markers)
    configs = [FlowConfig(bodies=(disc,), **flow) for disc in (small, big)]
    alone = [InPlaceSolver(config=config, compile=False, num_workers=0) for config in configs]
    batch = InPlaceSolver(config=configs[1], num_envs=2, compile=False, num_workers=0)
    params = make_params(configs).bodies[0]
    for given, rows in ((params, [True, False]), (make_params(configs[:1] * 2).bodies[0], None)):
        batch.set_body_(0, given, rows and torch.tensor(rows))
        for solver in (*alone, batch):
            solver.reset_(torch.ones(solver.num_envs, dtype=torch.bool), velocity=(1.0, 0.0))
            solver.advance_(20)
        drags = [solver.body.impulse[0, 0].item() for solver in alone]
        assert drags[0] < 0.8 * drags[1]
        expected = drags if rows else drags[:1] * 2
        assert batch.body.impulse[:, 0].tolist() == expected
