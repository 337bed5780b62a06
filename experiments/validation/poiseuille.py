"""Poiseuille flow.

A channel H nodes wide, periodic along x, is driven by a uniform body force with τ = 0.9 and a peak
speed of 1.6 / H. Its walls are either half-way bounce-back, half a node outside the edge nodes, or
non-equilibrium extrapolation, on the edge nodes. The readable step runs for six decay times of the
slowest mode. The error is the largest difference from the parabola relative to its peak. Its order
refers to the distance of the walls: H node distances for the first kind, H − 1 for the second.
"""

from collections.abc import Iterator
from typing import Any

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import draw_convergence, fit_order
from fishrl.physics import Boundaries, NonEquilibrium, NoSlip, Periodic
from fishrl.physics.cases import measure_poiseuille_error

HALF_WAY = "half-way bounce-back"
WALLS = {HALF_WAY: NoSlip(), "non-equilibrium extrapolation": NonEquilibrium(velocity=(0.0, 0.0))}
HEIGHTS = (8, 16, 32, 64)
JUDGED_HEIGHT = 32


def run_channel(*, walls: str, height: int) -> Result:
    """Return the largest error of a steady channel, ``height`` nodes across, between ``WALLS``."""
    wall = WALLS[walls]
    boundaries = Boundaries(left=Periodic(), right=Periodic(), bottom=wall, top=wall)
    return {"error": measure_poiseuille_error(height, boundaries)}


JOBS = [
    # steps grow as H²; a few nodes, so a step costs the same
    Job(run_channel, {"walls": walls, "height": n}, cost=2e4 * n**2, is_quick=n < 64)
    for walls in WALLS
    for n in HEIGHTS
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check order and error for each kind of wall."""
    for walls in WALLS:
        errors, lost = runs.read("error", "height", walls=walls), 0 if walls == HALF_WAY else 1
        order = fit_order({n - lost: e for n, e in errors.items()})
        name, heights = f"order of the profile error, {walls}", f"H = {min(errors)}–{max(errors)}"
        criterion: Any = (2.0, "second-order method", 0.1)
        yield Check(name, order, *criterion, is_absolute=True, resolution=heights)
        name, criterion = f"largest profile error / peak, {walls}", ((0.0, 1e-3), "own criterion")
        yield check_refined("H", name, errors, *criterion, at=JUDGED_HEIGHT)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the error against resolution."""
    axes = figure.subplots()
    draw_convergence(axes, {walls: runs.read("error", "height", walls=walls) for walls in WALLS})
    axes.set(xlabel="nodes H across the channel", ylabel="largest error / peak speed")
    axes.set_title("Poiseuille flow driven by a body force, τ = 0.9")


CASE = Case("poiseuille", __doc__, "exact parabola", JOBS, judge, draw)
