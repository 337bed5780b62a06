"""Collision operators: pure functions of nine populations.

Populations are *shifted*: ``f`` holds f_i - w_i, so that single precision keeps its digits and rest
is exactly zero (Lehmann et al. 2022). All functions take and return sequences of nine tensors of
any common shape and broadcast the relaxation rates against it.

Moments as in Lallemand & Luo 2000, m = (rho, e, eps, jx, qx, jy, qy, pxx, pxy), with the
equilibrium m_eq = rho (1, -2 + 3 u^2, 1 - 3 u^2, ux, -ux, uy, -uy, ux^2 - uy^2, ux uy), which
equals M f_eq of the second-order equilibrium exactly.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

from pydantic import Field
from torch import Tensor

from fishrl.physics.lattice import CX, CY, W
from fishrl.settings import Settings


class Rates(Settings):
    """Relaxation rates of the moments that do not set the viscosity.

    Args:
        energy: rate of e and eps; sets the bulk viscosity (1 / energy - 1/2) / 3.
        flux: rate of the energy fluxes qx and qy.

    Near tau = 0.5 the flux rate decides stability when vortices are shed in a turn: at 1.2 most
    flows with a fish that turns at the paper's own speed diverge, from 1.6 on hardly any (see the
    map on the validation page). The energy rate is that of Lallemand & Luo; a lower one damps
    sound more and slows a fish.
    """

    energy: Annotated[float, Field(gt=0, lt=2)] = 1.64
    flux: Annotated[float, Field(gt=0, lt=2)] = 1.7


class Macroscopic(NamedTuple):
    """Fluid at some nodes, without the half-force: rho - 1 and u* = j / rho, any common shape."""

    drho: Tensor
    ux: Tensor
    uy: Tensor

    @property
    def rho(self) -> Tensor:
        """Density."""
        return self.drho + 1.0


class Collided(NamedTuple):
    """The fluid between collision and streaming; fields ``[B, Y, X]``."""

    f: Sequence[Tensor]  #: nine populations after collision without force
    fluid: Macroscopic  #: before collision
    force: Tensor  #: ``[B, 2, Y, X]`` external body-force density
    omega: Tensor  #: 1 / tau, broadcasts
    rates: Rates  #: the other relaxation rates

    def add_force(self, force: Tensor) -> list[Tensor]:
        """Return the populations of a collision with a body-force density ``[B, 2, Y, X]``."""
        fx, fy = force.unbind(1)
        increment = compute_force_increment(self.fluid, (fx, fy), self.omega, self.rates)
        return [a + b for a, b in zip(self.f, increment, strict=True)]


def compute_moments(f: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Return the density deviation rho - 1 and the momentum (jx, jy), without the half-force."""
    f0, f1, f2, f3, f4, f5, f6, f7, f8 = f
    p57, p68, d57, d68 = f5 + f7, f6 + f8, f5 - f7, f6 - f8
    drho = f0 + ((f1 + f3) + (f2 + f4)) + (p57 + p68)
    return drho, (f1 - f3) + (d57 - d68), (f2 - f4) + (d57 + d68)


def compute_macroscopic(f: Sequence[Tensor]) -> Macroscopic:
    """Return density deviation and velocity, without the half-force."""
    drho, jx, jy = compute_moments(f)
    rho = drho + 1.0
    return Macroscopic(drho, jx / rho, jy / rho)


def compute_equilibrium(drho: Tensor, ux: Tensor, uy: Tensor) -> list[Tensor]:
    """Return the shifted equilibrium f_eq - w at density deviation rho - 1 and velocity.

    f_eq = w rho (1 + 3 c.u + 4.5 (c.u)^2 - 1.5 u^2), by pairs of opposite directions.
    """
    rho = drho + 1.0
    rest = drho - rho * (1.5 * (ux * ux + uy * uy))
    f_eq = [W[0] * rest]
    for first, along in ((1, (ux, uy)), (5, (ux + uy, uy - ux))):
        w, flux = W[first], [3.0 * rho * u for u in along]
        even = [w * (rest + 1.5 * u * j) for u, j in zip(along, flux, strict=True)]
        odd = [w * j for j in flux]
        f_eq += [e + o for e, o in zip(even, odd, strict=True)]
        f_eq += [e - o for e, o in zip(even, odd, strict=True)]
    return f_eq


class Moments(NamedTuple):
    """Density, momentum, and by how much the other moments differ from equilibrium, m - m_eq."""

    drho: Tensor  #: rho - 1, any shape common to all
    jx: Tensor
    jy: Tensor
    e: Tensor
    eps: Tensor
    qx: Tensor
    qy: Tensor
    pxx: Tensor
    pxy: Tensor


def measure_moments(f: Sequence[Tensor]) -> Moments:
    """Return the moments of nine populations.

    The products of M are unrolled over sums and differences of opposite populations, so no matrix
    appears.
    """
    f0, f1, f2, f3, f4, f5, f6, f7, f8 = f
    a13, a24, a57, a68 = f1 + f3, f2 + f4, f5 + f7, f6 + f8
    d13, d24, d57, d68 = f1 - f3, f2 - f4, f5 - f7, f6 - f8
    axis, diagonal = a13 + a24, a57 + a68
    drho = f0 + axis + diagonal
    jx, jy = d13 + (d57 - d68), d24 + (d57 + d68)
    inverse = 1.0 / (drho + 1.0)
    jxx, jyy, jxy = jx * jx * inverse, jy * jy * inverse, jx * jy * inverse
    u2 = 3.0 * (jxx + jyy)
    return Moments(
        drho=drho,
        jx=jx,
        jy=jy,
        e=-4.0 * f0 - axis + 2.0 * diagonal + 2.0 * drho - u2,
        eps=4.0 * f0 - 2.0 * axis + diagonal - drho + u2,
        qx=-2.0 * d13 + (d57 - d68) + jx,
        qy=-2.0 * d24 + (d57 + d68) + jy,
        pxx=a13 - a24 - (jxx - jyy),
        pxy=a57 - a68 - jxy,
    )


def rebuild(moments: Moments, stress: Tensor, others: float) -> list[Tensor]:
    """Return populations: f_eq + M^-1 (m - m_eq), with m - m_eq times given factors.

    ``stress`` is that of pxx and pxy and broadcasts, ``others`` that of e, eps, qx and qy.
    """
    drho, jx, jy, e, eps, qx, qy, pxx, pxy = moments
    rho = drho + 1.0
    f_eq = compute_equilibrium(drho, jx / rho, jy / rho)
    change = _from_moments(
        others * e, others * eps, others * qx, others * qy, stress * pxx, stress * pxy
    )
    return [a + b for a, b in zip(f_eq, change, strict=True)]


def collide_mrt(f: Sequence[Tensor], omega: Tensor | float, rates: Rates) -> list[Tensor]:
    """Relax the moments towards equilibrium, without force: f - M^-1 S (m - m_eq).

    Args:
        f: nine incoming populations (shifted).
        omega: 1 / tau, the rate of the stresses pxx and pxy; broadcasts (one per flow).
        rates: the other rates.

    By sums and differences of opposite populations: since e and eps have one rate, f0 and the sums
    over axes and diagonals relax with it, the differences of these sums with omega.

    Source: Lallemand & Luo 2000, eq. 13; the paper's eq. 1 without force.
    """
    f0, f1, f2, f3, f4, f5, f6, f7, f8 = f
    a13, a24, a57, a68 = f1 + f3, f2 + f4, f5 + f7, f6 + f8
    d13, d24, d57, d68 = f1 - f3, f2 - f4, f5 - f7, f6 - f8
    axis, diagonal, x, y = a13 + a24, a57 + a68, d57 - d68, d57 + d68
    drho, jx, jy = f0 + axis + diagonal, d13 + x, d24 + y
    inverse = 1.0 / (drho + 1.0)
    ux, uy = jx * inverse, jy * inverse
    jxx, jyy = ux * jx, uy * jy
    energy, flux, stress = rates.energy, rates.flux / 12.0, 0.25 * omega
    # by how much f0 and the means over axes and diagonals differ from equilibrium
    weight, power = drho * (1 / 36), (jxx + jyy) * (1 / 12)
    rest = f0 - 16.0 * weight + 8.0 * power
    on_axis, on_diagonal = 0.25 * axis - 4.0 * weight - power, 0.25 * diagonal - weight - power
    pxx4, pxy4 = stress * (a13 - a24 - (jxx - jyy)), stress * (a57 - a68 - ux * jy)
    # after collision half of the sum of opposite populations, and half of their difference
    s13, s24 = 0.5 * a13 - (energy * on_axis + pxx4), 0.5 * a24 - (energy * on_axis - pxx4)
    s57, s68 = 0.5 * a57 - (energy * on_diagonal + pxy4), 0.5 * a68 - (energy * on_diagonal - pxy4)
    h13, h24 = (0.5 - 2.0 * flux) * d13 + 4.0 * flux * x, (0.5 - 2.0 * flux) * d24 + 4.0 * flux * y
    h57 = (0.5 - 4.0 * flux) * d57 + flux * (d24 + d13)
    h68 = (0.5 - 4.0 * flux) * d68 + flux * (d24 - d13)
    return [
        f0 - energy * rest,
        *(s13 + h13, s24 + h24, s13 - h13, s24 - h24),
        *(s57 + h57, s68 + h68, s57 - h57, s68 - h68),
    ]


def _from_moments(
    e: Tensor, eps: Tensor, qx: Tensor, qy: Tensor, pxx: Tensor, pxy: Tensor
) -> list[Tensor]:
    """Return M^-1 applied to a moment change that leaves density and momentum alone."""
    e36, eps36 = e * (1 / 36), eps * (1 / 36)
    x6, y6 = qx * (1 / 6), qy * (1 / 6)
    pxx4, pxy4 = pxx * 0.25, pxy * 0.25
    axis = -e36 - 2.0 * eps36
    diagonal = 2.0 * e36 + eps36
    sum6, difference6 = 0.5 * (x6 + y6), 0.5 * (y6 - x6)
    return [
        4.0 * (eps36 - e36),
        axis - x6 + pxx4,
        axis - y6 - pxx4,
        axis + x6 + pxx4,
        axis + y6 - pxx4,
        diagonal + sum6 + pxy4,
        diagonal + difference6 - pxy4,
        diagonal - sum6 + pxy4,
        diagonal - difference6 - pxy4,
    ]


def compute_force_increment(
    fluid: Macroscopic,
    force: tuple[Tensor, Tensor],
    omega: Tensor | float,
    rates: Rates,
    *,
    share: tuple[Tensor, Tensor] | None = None,
) -> list[Tensor]:
    """Return what a body force adds to the post-collision populations.

    Forced collision (Guo, Zheng & Shi 2002 in moment form, equal to the paper's eq. 1 with Cheng's
    forcing after the change of variable f - g/2) minus unforced collision reduces to

        delta m = M g(u* + F / 2 rho, F) - (s / 4 rho) Q(F, F),

    Q being the quadratic form of m_eq, because M g(u + F / 2 rho, F) = m_eq(u + F / rho) - m_eq(u).
    Given the node's total force it is linear in ``share``, so the contributions of several markers
    to one node may be added one by one.

    Args:
        fluid: density and unforced velocity at the nodes.
        force: total body-force density at the node (x, y).
        omega: 1 / tau.
        rates: the other rates.
        share: part of the force whose increment is returned (x, y); None is all of it.
    """
    _, ux, uy = fluid
    fx, fy = force
    sx, sy = force if share is None else share
    half = 0.5 / fluid.rho
    # the force works on u* + (1 - s/4) F / (2 rho), with the rate s of the moment at hand
    gx, gy = fx * half, fy * half
    ex, ey = ux + (1.0 - 0.25 * rates.energy) * gx, uy + (1.0 - 0.25 * rates.energy) * gy
    px, py = ux + (1.0 - 0.25 * omega) * gx, uy + (1.0 - 0.25 * omega) * gy
    e = 6.0 * (ex * sx + ey * sy)
    pxx = 2.0 * (px * sx - py * sy)
    pxy = px * sy + py * sx
    change = _from_moments(e, -e, -sx, -sy, pxx, pxy)
    x6, y6 = sx * (1 / 6), sy * (1 / 6)
    return [
        c + (cx * x6 + cy * y6) if cx or cy else c for c, cx, cy in zip(change, CX, CY, strict=True)
    ]
