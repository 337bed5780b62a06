"""Kernels, coupling matrix and force solves."""

import math
from itertools import pairwise

import pytest
import torch

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.geometry import deform_body, place_markers
from fishrl.physics.skins import DirectSolve, ImmersedBoundary, IterativeForcing
from fishrl.physics.skins.delta import SPECTRUM, interpolate, make_stencil, overlap_markers
from fishrl.physics.skins.immersed_boundary import gather, spread
from tests.physics.flows import place_body

SIZE = 96
FIT = ImmersedBoundary().fit
FISH = FIT(Fish(body_length=50))


def make_markers(heading: float = 0.7, fish: Fish = FISH) -> torch.Tensor:
    """A deformed fish in the middle of the grid."""
    body = place_body(48.3, 47.6, heading, 1 / 500, beats=1.8, phase=1.1)
    return place_markers(body, deform_body(fish, fish.make_params(), body)).position


def test_kernel_moments_do_not_depend_on_position() -> None:
    markers = 20 + torch.rand(1, 500, 2, dtype=torch.float64)
    stencil = make_stencil(markers, SIZE, SIZE, torch.float64)
    one = torch.ones(1, 500, dtype=torch.float64)
    torch.testing.assert_close(stencil.weights.sum(1), one)
    torch.testing.assert_close(stencil.weight_x.square().sum(1), 0.5 * one)
    # first moment: a linear field is interpolated exactly
    x = (stencil.index_nodes(SIZE) % SIZE).double()
    torch.testing.assert_close(interpolate(x, stencil.weights), markers[..., 0])


def test_coupling_matrix_equals_spread_then_interpolate() -> None:
    stencil = make_stencil(make_markers(), SIZE, SIZE, torch.float64)
    nodes, weights = stencil.index_nodes(SIZE), stencil.weights
    g = torch.randn(1, weights.shape[-1], dtype=torch.float64)
    field = spread(0.9 * weights * g[:, None], nodes, torch.zeros(1, SIZE, SIZE).double())
    expected = interpolate(gather(field, nodes), weights)
    got = 0.9 * overlap_markers(stencil) @ g[..., None]
    torch.testing.assert_close(got[..., 0], expected)


@pytest.mark.parametrize("heading", [0.0, 0.7, math.pi / 2])
@pytest.mark.parametrize("fish", [FISH, FIT(Fish(body_length=50, thickness=0.02, inset=1.0))])
def test_the_kernels_spectrum_bounds_the_coupling(heading: float, fish: Fish) -> None:
    """Also where the sides of a body meet, as the inset of a thin one lets them."""
    stencil = make_stencil(make_markers(heading, fish), SIZE, SIZE, torch.float64)
    root = fish.make_params().spacing.sqrt()
    largest = torch.linalg.eigvalsh(root.mT * overlap_markers(stencil)[0] * root)[-1]
    assert 0.45 * SPECTRUM < largest < SPECTRUM


def measure_slip(solve: IterativeForcing | DirectSolve) -> float:
    """Relative rms slip left of an impulsive smooth target."""
    markers = make_markers()
    overlap = overlap_markers(make_stencil(markers, SIZE, SIZE, torch.float64))
    target = torch.cos(0.1 * markers[..., :1]).mT
    _, rest = solve(solve.prepare(overlap, FISH.make_params().spacing), target)
    return float(rest.norm() / target.norm())


def test_slip_falls_with_iterations_and_vanishes_in_a_direct_solve() -> None:
    slips = [measure_slip(IterativeForcing.zhang(n)) for n in (1, 3, 5, 7, 10)]
    assert all(later < 0.6 * earlier for earlier, later in pairwise(slips))
    assert slips[-1] < 0.02
    assert measure_slip(IterativeForcing(num_iterations=4)) < slips[3]
    assert measure_slip(DirectSolve(regularisation=1e-12)) < 1e-12


def test_markers_outside_the_grid_read_no_foreign_memory() -> None:
    markers = torch.tensor([[[-50.0, 1e9], [float("nan"), 3.0]]], dtype=torch.float64)
    nodes = make_stencil(markers, SIZE, SIZE, torch.float64).index_nodes(SIZE)
    assert nodes.min() >= 0 and nodes.max() < SIZE * SIZE
