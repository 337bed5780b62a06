"""Analytic flows that tests, docs and benchmarks share. Lattice units throughout."""

from math import exp, log, pi

import torch
from torch import Tensor

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Commanded, Motion
from fishrl.physics.boundaries import Boundaries, NoSlip, Periodic
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import FlowConfig, FlowState, make_params, make_uniform
from fishrl.physics.step import step
from fishrl.physics.units import Scales

PERIODIC = Boundaries(left=Periodic(), right=Periodic(), bottom=Periodic(), top=Periodic())


def make_taylor_green(size: int, speed: float, time: float, nu: float) -> tuple[Tensor, Tensor]:
    """Return density deviation ``[1, Y, X]`` and velocity ``[1, 2, Y, X]`` of Taylor's vortices.

    u = -U cos kx sin ky, v = U sin kx cos ky, both times exp(-2 nu k^2 t);
    p = -U^2/4 (cos 2kx + cos 2ky) exp(-4 nu k^2 t), k = 2 pi / size (Taylor & Green 1937).

    Args:
        size: nodes along each axis of the periodic box.
        speed: U.
        time: steps.
        nu: kinematic viscosity.
    """
    k = 2.0 * pi / size
    x = k * torch.arange(size, dtype=torch.float64)[None, None, :]
    y = k * torch.arange(size, dtype=torch.float64)[None, :, None]
    decay = exp(-2.0 * nu * k * k * time)
    u = torch.stack((-torch.cos(x) * torch.sin(y), torch.sin(x) * torch.cos(y)), 1)
    drho = -0.75 * (speed * decay) ** 2 * (torch.cos(2 * x) + torch.cos(2 * y))
    return drho, speed * decay * u


def decay_taylor_green(
    size: int, *, reynolds: float = 20.0, speed: float = 0.64, dtype: torch.dtype = torch.float64
) -> tuple[float, float]:
    """Let Taylor's vortices decay for one decay time 1 / (2 nu k^2), diffusive scaling.

    Args:
        size: nodes N along each axis; the speed is ``speed`` / N, so the Mach number falls with
            the grid and the error is second order.
        reynolds: U N / nu.
        speed: U N.
        dtype: float type of the populations.

    Returns:
        The relative L2 error of the velocity at the end, and the viscosity, from the decay of the
        amplitude over the second half, relative to (tau - 1/2) / 3.
    """
    u0, k = speed / size, 2.0 * pi / size
    nu = u0 * size / reynolds
    config = FlowConfig(width=size, height=size, tau=3.0 * nu + 0.5, boundaries=PERIODIC)
    half = round(1.0 / (4.0 * nu * k * k))
    drho, u = make_taylor_green(size, u0, 0.0, nu)
    state = FlowState(make_uniform(drho, u[:, 0], u[:, 1]).to(dtype))
    params, amplitudes = make_params([config]), []
    for _ in range(2):
        for _ in range(half):
            state = step(state, config, params)
        velocity = _measure_velocity(state.f.double())
        amplitudes.append(float((velocity * u).sum() / (u * u).sum()))
    measured = log(amplitudes[0] / amplitudes[1]) / (2.0 * k * k * half)
    _, exact = make_taylor_green(size, u0, 2 * half, nu)
    return float((velocity - exact).norm() / exact.norm()), measured / nu


def measure_poiseuille_error(height: int, boundaries: Boundaries, *, tau: float = 0.9) -> float:
    """Return the largest profile error of a force-driven channel, relative to its peak speed.

    ``height`` counts the nodes across; ``boundaries`` are periodic along x. The walls stand where
    the boundary puts them: half a node outside for ``NoSlip``, on the edge nodes for
    non-equilibrium extrapolation.
    """
    config = FlowConfig(width=4, height=height, tau=tau, boundaries=boundaries)
    is_half_way = isinstance(boundaries.bottom, NoSlip)
    wall = 0.5 if is_half_way else 0.0
    y = torch.arange(height, dtype=torch.float64) + wall
    gap = height - 1.0 + 2.0 * wall
    peak = 1.6 / height
    force = torch.zeros(1, 2, height, 4, dtype=torch.float64)
    force[:, 0] = 8.0 * config.nu * peak / gap**2
    exact = 4.0 * peak * y * (gap - y) / gap**2
    rest = torch.zeros(1, height, 4, dtype=torch.float64)
    state = FlowState(make_uniform(rest, rest + exact[:, None], rest))
    params = make_params([config])
    for _ in range(int(6.0 * gap**2 / (pi**2 * config.nu))):  # six decay times of the slowest mode
        state = step(state, config, params, external_force=force)
    u = _measure_velocity(state.f)[0, 0, :, 0] + 0.5 * force[0, 0, :, 0]
    inner = slice(None) if is_half_way else slice(1, -1)
    return float((u - exact)[inner].abs().max() / peak)


def make_swimmer_config(
    scales: Scales,
    *,
    length_bl: float = 10.0,
    height_bl: float = 5.0,
    motion: Motion | None = None,
    **changes: object,
) -> FlowConfig:
    """Return the paper's tank, 10 L x 5 L with walls all round, and a NACA0012 fish in it.

    The fish's heading is commanded unless ``motion`` says otherwise; ``changes`` are any other
    fields of ``FlowConfig``.
    """
    motion = Commanded() if motion is None else motion
    fields: dict[str, object] = {
        "width": round(length_bl * scales.body_length),
        "height": round(height_bl * scales.body_length),
        "tau": scales.tau,
        "bodies": (Fish(body_length=scales.body_length, gait=scales.gait, motion=motion),),
    }
    return FlowConfig(**(fields | changes))  # type: ignore[arg-type]


def _measure_velocity(f: Tensor) -> Tensor:
    _, ux, uy = compute_macroscopic(f.unbind(1))
    return torch.stack((ux, uy), 1)
