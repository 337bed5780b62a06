"""Analytic flows: the order of the method and the places of its walls."""

from math import log2

import pytest

from fishrl.physics.boundaries import Boundaries, Boundary, NonEquilibrium, NoSlip, Periodic
from fishrl.physics.cases import decay_taylor_green, measure_poiseuille_error

WALL = NonEquilibrium(velocity=(0.0, 0.0))


def test_taylor_green_vortices_decay_with_second_order() -> None:
    (coarse, _), (fine, viscosity) = (decay_taylor_green(n) for n in (16, 32))
    assert log2(coarse / fine) > 1.95
    assert fine < 0.01
    assert viscosity == pytest.approx(1.0, rel=5e-3)


@pytest.mark.parametrize("wall", [NoSlip(), WALL], ids=["no-slip", "non-equilibrium"])
def test_poiseuille_profile_is_second_order(wall: Boundary) -> None:
    boundaries = Boundaries(left=Periodic(), right=Periodic(), bottom=wall, top=wall)
    coarse, fine = (measure_poiseuille_error(n, boundaries) for n in (8, 16))
    assert log2(coarse / fine) > 1.9
    assert fine < 4e-3  # half-way bounce-back: 3.2e-3, it depends on tau and the flux rate
