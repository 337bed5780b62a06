"""Taylor–Green vortices.

One pair of vortices in each direction of a periodic box of N × N nodes: u = −U cos kx sin ky, v = U
sin kx cos ky, k = 2π/N, U N / ν = 20. The exact solution decays as exp(−2νk²t). Scaling is
diffusive: U = 0.64 / N at the same τ = 0.596 on all grids, so that compressibility errors decrease
with the grid spacing squared. The readable step runs for one decay time 1 / (2νk²) in double and in
single precision (shifted populations). The viscosity follows from the loss of amplitude in the
second half.
"""

from collections.abc import Iterator
from math import inf

import torch
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import draw_convergence, fit_order
from fishrl.physics.cases import decay_taylor_green

SIZES = (16, 32, 64, 128)
SOURCE = "Taylor & Green 1937"


def decay_vortices(*, size: int, is_single: bool) -> Result:
    """Return ``error`` and ``viscosity`` of ``decay_taylor_green`` in a box of ``size`` nodes."""
    dtype = torch.float32 if is_single else torch.float64
    error, viscosity = decay_taylor_green(size, dtype=dtype)
    return {"error": error, "viscosity": viscosity}


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
