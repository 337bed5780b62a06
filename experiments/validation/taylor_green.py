"""Taylor–Green vortices.

One pair of vortices in each direction of a periodic box of N × N nodes: u = −U cos kx sin ky, v = U
sin kx cos ky, k = 2π/N, U N / ν = 20. The exact solution decays as exp(−2νk²t). Scaling is
diffusive: U = 0.64 / N at the same τ = 0.596 on all grids, so that compressibility errors decrease
with the grid spacing squared. The readable step runs for one decay time 1 / (2νk²) in double and in
single precision (shifted populations). The viscosity follows from the loss of amplitude in the
second half.
"""

from collections.abc import Iterator
from math import exp, inf, log, pi

import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import draw_convergence, fit_order
from fishrl.physics import FlowConfig, FlowState
from fishrl.physics.cases import PERIODIC
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import make_params, make_uniform
from fishrl.physics.step import step

SIZES = (16, 32, 64, 128)
REYNOLDS = 20.0  # U N / nu
SPEED = 0.64  # U N
SOURCE = "Taylor & Green 1937"


def make_vortices(size: int, time: float, nu: float) -> tuple[Tensor, Tensor]:
    """Return density - 1 ``[1, Y, X]`` and velocity ``[1, 2, Y, X]`` after ``time`` steps.

    p = -U^2/4 (cos 2kx + cos 2ky) exp(-4 nu k^2 t).
    """
    k = 2.0 * pi / size
    x = k * torch.arange(size, dtype=torch.float64)[None, None, :]
    y = k * torch.arange(size, dtype=torch.float64)[None, :, None]
    decay = SPEED / size * exp(-2.0 * nu * k * k * time)
    u = torch.stack((-torch.cos(x) * torch.sin(y), torch.sin(x) * torch.cos(y)), 1)
    drho = -0.75 * decay**2 * (torch.cos(2 * x) + torch.cos(2 * y))
    return drho, decay * u


def decay_vortices(*, size: int, is_single: bool) -> Result:
    """Let vortices decay in a box of ``size`` nodes.

    Returns the relative L2 ``error`` of the velocity at the end, and the ``viscosity`` relative to
    (tau - 1/2) / 3.
    """
    nu, k = SPEED / REYNOLDS, 2.0 * pi / size
    config = FlowConfig(width=size, height=size, tau=3.0 * nu + 0.5, boundaries=PERIODIC)
    half = round(1.0 / (4.0 * nu * k * k))
    drho, start = make_vortices(size, 0.0, nu)
    f = make_uniform(drho, start[:, 0], start[:, 1])
    state = FlowState(f.to(torch.float32 if is_single else torch.float64))
    params, amplitudes = make_params([config]), []
    for _ in range(2):
        for _ in range(half):
            state = step(state, config, params)
        fluid = compute_macroscopic(state.f.double().unbind(1))
        velocity = torch.stack((fluid.ux, fluid.uy), 1)
        amplitudes.append(float((velocity * start).sum() / (start * start).sum()))
    measured = log(amplitudes[0] / amplitudes[1]) / (2.0 * k * k * half)
    _, exact = make_vortices(size, 2 * half, nu)
    error = float((velocity - exact).norm() / exact.norm())
    return {"error": error, "viscosity": measured / nu}


JOBS = [
    # steps grow as N²; eager, so each costs much
    Job(decay_vortices, {"size": n, "is_single": single}, cost=4.0 * n**4, is_quick=n < 128)
    for single in (False, True)
    for n in SIZES
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check order, viscosity and what single precision costs."""
    double, single = (runs.read("error", "size", is_single=each) for each in (False, True))
    order, grids = "order of the L2 velocity error", f"N = {min(double)}–{max(double)}"
    yield Check(order, fit_order(double), (1.95, inf), "second-order method", resolution=grids)
    yield check_refined("N", "L2 velocity error", double)
    viscosity = runs.read("viscosity", "size", is_single=False)
    yield check_refined("N", "viscosity ν / ((τ − ½) / 3)", viscosity, 1.0, SOURCE, 0.005)
    ratios = {n: single[n] / double[n] for n in double}
    worst, name = max(ratios, key=lambda n: ratios[n]), "error in float32 / in float64, worst grid"
    yield check_refined("N", name, ratios, (0.0, 2.0), "own criterion", at=worst)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the error against resolution."""
    axes = figure.subplots()
    names = {"double precision": False, "single precision": True}
    draw_convergence(
        axes, {name: runs.read("error", "size", is_single=each) for name, each in names.items()}
    )
    axes.set(xlabel="nodes N along the box", ylabel="relative L2 error of velocity")
    axes.set_title("Taylor–Green vortices after one decay time, Re = 20")


CASE = Case("taylor-green", __doc__, SOURCE, JOBS, judge, draw)
