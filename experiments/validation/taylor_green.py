"""Taylor–Green vortices.

One pair of vortices in each direction of a periodic box of N × N nodes: u = −U cos kx sin ky, v = U
sin kx cos ky, k = 2π/N, U N / ν = 20. The exact solution decays as exp(−2νk²t). Scaling is
diffusive: U = 0.64 / N at the same τ = 0.596 on all grids, so that compressibility errors decrease
with the grid spacing squared. The readable step runs for one decay time 1 / (2νk²) in double and in
single precision (shifted populations). The viscosity follows from the loss of amplitude in the
second half.
"""

from collections.abc import Iterator
from math import inf, log, pi

import torch
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_finest
from experiments.validation.plots import draw_convergence, fit_order
from fishrl.physics.cases import PERIODIC, make_taylor_green
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import FlowConfig, FlowState, make_params, make_uniform
from fishrl.physics.step import step

REYNOLDS = 20.0
SPEED = 0.64  # U N
SIZES = (16, 32, 64, 128)
SOURCE = "Taylor & Green 1937"


def decay_vortices(*, size: int, is_single: bool) -> Result:
    """Let the vortices of a box of N = ``size`` nodes decay for one decay time, U = 0.64 / N.

    Returns ``error``, the relative L2 error of the velocity at the end, and ``viscosity``, from the
    decay of the amplitude over the second half, relative to (tau - 1/2) / 3.
    """
    speed, k = SPEED / size, 2.0 * pi / size
    nu = speed * size / REYNOLDS
    config = FlowConfig(width=size, height=size, tau=3.0 * nu + 0.5, boundaries=PERIODIC)
    half = round(1.0 / (4.0 * nu * k * k))
    drho, u = make_taylor_green(size, speed, 0.0, nu)
    dtype = torch.float32 if is_single else torch.float64
    state = FlowState(make_uniform(drho, u[:, 0], u[:, 1]).to(dtype))
    params, amplitudes = make_params([config]), []
    for _ in range(2):
        for _ in range(half):
            state = step(state, config, params)
        _, ux, uy = compute_macroscopic(state.f.double().unbind(1))
        velocity = torch.stack((ux, uy), 1)
        amplitudes.append(float((velocity * u).sum() / (u * u).sum()))
    measured = log(amplitudes[0] / amplitudes[1]) / (2.0 * k * k * half)
    _, exact = make_taylor_green(size, speed, 2 * half, nu)
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
    order = "order of the L2 velocity error"
    grids = f"N = {min(double)}–{max(double)}"
    source = "second-order method"
    yield Check(order, fit_order(double), (1.95, inf), source, resolution=grids)
    yield check_finest("N", "L2 velocity error", double)
    viscosity = runs.read("viscosity", "size", is_single=False)
    yield check_finest("N", "viscosity ν / ((τ − ½) / 3)", viscosity, 1.0, SOURCE, 0.005)
    ratios = {n: single[n] / double[n] for n in double}
    worst = max(ratios, key=lambda n: ratios[n])
    yield Check(
        "error in float32 / in float64, worst grid",
        ratios[worst],
        (0.0, 2.0),
        "own criterion",
        resolution=f"N = {worst}",
        refinement={f"N = {n}": r for n, r in ratios.items()},
    )


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
