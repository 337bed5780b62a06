"""The unrolled collision against the matrices of the literature."""

import pytest
import torch

from fishrl.physics.collision import (
    Macroscopic,
    Rates,
    collide_mrt,
    compute_equilibrium,
    compute_force_increment,
    compute_macroscopic,
)
from fishrl.physics.lattice import CX, CY, W

# Lallemand & Luo 2000: rows rho, e, eps, jx, qx, jy, qy, pxx, pxy
M = torch.tensor(
    [
        [1, 1, 1, 1, 1, 1, 1, 1, 1],
        [-4, -1, -1, -1, -1, 2, 2, 2, 2],
        [4, -2, -2, -2, -2, 1, 1, 1, 1],
        [0, 1, 0, -1, 0, 1, -1, -1, 1],
        [0, -2, 0, 2, 0, 1, -1, -1, 1],
        [0, 0, 1, 0, -1, 1, 1, -1, -1],
        [0, 0, -2, 0, 2, 1, 1, -1, -1],
        [0, 1, -1, 1, -1, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 1, -1, 1, -1],
    ],
    dtype=torch.float64,
)
C = torch.tensor([CX, CY], dtype=torch.float64)
WEIGHTS = torch.tensor(W, dtype=torch.float64)
RATES, OMEGA = Rates(energy=1.3, flux=1.1), 1.8
S = torch.tensor([0, 1.3, 1.3, 0, 1.1, 0, 1.1, OMEGA, OMEGA], dtype=torch.float64)


def make_populations() -> torch.Tensor:
    g = torch.Generator().manual_seed(0)
    return WEIGHTS * (1.0 + 0.1 * torch.randn(9, generator=g, dtype=torch.float64))


def equilibrium(rho: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    cu = C.T @ u
    return WEIGHTS * rho * (1 + 3 * cu + 4.5 * cu**2 - 1.5 * (u @ u))


def force_populations(u: torch.Tensor, force: torch.Tensor) -> torch.Tensor:
    cu = C.T @ u
    return WEIGHTS * (3 * (C.T @ force - u @ force) + 9 * cu * (C.T @ force))


def collide_with_force(f: torch.Tensor, force: torch.Tensor) -> torch.Tensor:
    shifted = (f - WEIGHTS).unbind()
    fx, fy = force
    added = compute_force_increment(compute_macroscopic(shifted), (fx, fy), OMEGA, RATES)
    collided = collide_mrt(shifted, OMEGA, RATES)
    return torch.stack([a + b for a, b in zip(collided, added, strict=True)]) + WEIGHTS


@pytest.mark.parametrize("force", [(0.0, 0.0), (0.02, -0.03)])
def test_collision_equals_its_matrix_form_and_guos_force(force: tuple[float, float]) -> None:
    """The paper's implicit Eq. 1 is the same in f - g / 2."""
    f, g = make_populations(), torch.tensor(force, dtype=torch.float64)
    rho = f.sum()
    u = (C @ f + g / 2) / rho
    source = torch.linalg.solve(M, (1 - S / 2) * (M @ force_populations(u, g)))
    expected = f - torch.linalg.solve(M, S * (M @ (f - equilibrium(rho, u)))) + source
    torch.testing.assert_close(collide_with_force(f, g), expected, rtol=0, atol=1e-15)


def test_shares_of_the_force_add_up_to_the_whole() -> None:
    drho, ux, uy, fx, fy = torch.tensor([0.1, 0.2, -0.1, 0.3, 0.4]).double()
    fluid = Macroscopic(drho, ux, uy)
    whole = compute_force_increment(fluid, (fx, fy), OMEGA, RATES)
    parts = [
        compute_force_increment(fluid, (fx, fy), OMEGA, RATES, share=(a * fx, b * fy))
        for a, b in ((0.3, 0.9), (0.7, 0.1))
    ]
    total = [p + q for p, q in zip(*parts, strict=True)]
    torch.testing.assert_close(torch.stack(total), torch.stack(whole), rtol=0, atol=1e-15)


def test_equilibrium_has_the_given_density_and_velocity() -> None:
    expected = torch.tensor([0.05, 0.1, -0.2]).double().unbind()
    got = compute_macroscopic(compute_equilibrium(*expected))
    torch.testing.assert_close(torch.stack(got), torch.stack(expected), rtol=0, atol=1e-15)
