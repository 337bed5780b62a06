"""Taylor–Green vortices.

One pair of vortices each way in a periodic box of N × N nodes, u = −U cos kx sin ky, v = U sin kx
cos ky, k = 2π/N, at U N / ν = 20. The exact solution decays as exp(−2νk²t). Diffusive scaling: U =
0.64 / N at the same τ = 0.596 on all grids, so that compressibility errors fall as the grid's do.
Run for one decay time 1 / (2νk²) with the readable step in double and in single precision (shifted
populations). Viscosity is read from what the amplitude loses over the second half.
"""

from collections.abc import Sequence
from math import inf, log, pi

import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation.case import Case, Check, Job, Result, Results, check_finest, select
from experiments.validation.convergence import draw_convergence, fit_order
from fishrl.physics.cases import PERIODIC, make_taylor_green
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import FlowConfig, FlowState, make_params, make_uniform
from fishrl.physics.step import step

REYNOLDS = 20.0
SPEED = 0.64  # U N
SIZES = (16, 32, 64, 128)
QUICK_SIZES = (16, 32, 64)
SOURCE = "Taylor & Green 1937"


def decay_vortices(*, size: int, is_single: bool) -> Result:
    """Let the vortices of a box of N = ``size`` nodes decay for one decay time, U = 0.64 / N.

    Returns ``error``, the relative L2 error of the velocity at the end, and ``viscosity``, what the
    amplitude lost over the second half says, relative to (tau - 1/2) / 3.
    """
    dtype = torch.float32 if is_single else torch.float64
    speed, k = SPEED / size, 2.0 * pi / size
    nu = speed * size / REYNOLDS
    config = FlowConfig(width=size, height=size, tau=3.0 * nu + 0.5, boundaries=PERIODIC)
    half = round(1.0 / (4.0 * nu * k * k))
    drho, u = make_taylor_green(size, speed, 0.0, nu)
    state = FlowState(make_uniform(drho, u[:, 0], u[:, 1]).to(dtype))
    params, amplitudes = make_params([config]), []
    for _ in range(2):
        for _ in range(half):
            state = step(state, config, params)
        velocity = _read_velocity(state)
        amplitudes.append(float((velocity * u).sum() / (u * u).sum()))
    measured = log(amplitudes[0] / amplitudes[1]) / (2.0 * k * k * half)
    _, exact = make_taylor_green(size, speed, 2 * half, nu)
    return {
        "error": float((velocity - exact).norm() / exact.norm()),
        "viscosity": measured / nu,
    }


def _read_velocity(state: FlowState) -> Tensor:
    _, ux, uy = compute_macroscopic(state.f.double().unbind(1))
    return torch.stack((ux, uy), 1)


def _label(size: int, is_single: bool) -> str:
    return f"N = {size}, {'float32' if is_single else 'float64'}"


def make_jobs(quick: bool) -> list[Job]:
    """Return a run for each size and precision."""
    return [
        Job(
            _label(size, is_single),
            decay_vortices,
            {"size": size, "is_single": is_single},
            cost=4.0 * size**4,  # steps grow as N²; eager, so each costs much
        )
        for is_single in (False, True)
        for size in (QUICK_SIZES if quick else SIZES)
    ]


def _read(results: Results, key: str, *, is_single: bool = False) -> dict[int, float]:
    runs = select(results, {n: _label(n, is_single) for n in SIZES})
    return {n: run[key] for n, run in runs.items()}


def judge(results: Results) -> Sequence[Check]:
    """Judge order, viscosity and what single precision costs."""
    double, single = _read(results, "error"), _read(results, "error", is_single=True)
    viscosity = _read(results, "viscosity")
    ratios = {n: single[n] / double[n] for n in double}
    return [
        Check(
            quantity="order of the L2 velocity error",
            ours=fit_order(double),
            reference=(1.95, inf),
            source="second-order method",
            resolution=f"N = {min(double)}–{max(double)}",
        ),
        check_finest("L2 velocity error", double, symbol="N"),
        check_finest("viscosity ν / ((τ − ½) / 3)", viscosity, 1.0, SOURCE, 0.005, symbol="N"),
        Check(
            quantity="error in float32 / in float64, worst grid",
            ours=max(ratios.values()),
            reference=(0.0, 2.0),
            source="own criterion",
            resolution=f"N = {max(ratios, key=lambda n: ratios[n])}",
            refinement={f"N = {n}": r for n, r in ratios.items()},
        ),
    ]


def draw(results: Results) -> Figure:
    """Draw the error against resolution."""
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    series = {
        "double precision": _read(results, "error"),
        "single precision": _read(results, "error", is_single=True),
    }
    draw_convergence(axes, series)
    axes.set(xlabel="nodes N along the box", ylabel="relative L2 error of velocity")
    axes.set_title("Taylor–Green vortices after one decay time, Re = 20", loc="left")
    return figure


CASE = Case("taylor-green", __doc__, SOURCE, make_jobs, judge, draw)
