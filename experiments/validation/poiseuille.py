"""Poiseuille flow.

Channel of H nodes across, periodic along x, driven by a uniform body force; τ = 0.9, peak speed 1.6
/ H. Two kinds of walls: half-way bounce-back, which stands half a node outside the edge nodes, and
non-equilibrium extrapolation, which stands on them. Run for six decay times of the slowest mode
with the readable step; the error is the largest difference from the parabola, as a share of its
peak. The order is taken over the width between the walls: H node distances with the first kind, H −
1 with the second.
"""

from collections.abc import Sequence

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Results, select
from experiments.validation.convergence import draw_convergence, fit_order
from fishrl.physics import Boundaries, NonEquilibrium, NoSlip, Periodic
from fishrl.physics.cases import measure_poiseuille_error

HALF_WAY = "half-way bounce-back"
WALLS = {HALF_WAY: NoSlip(), "non-equilibrium extrapolation": NonEquilibrium(velocity=(0.0, 0.0))}
HEIGHTS = (8, 16, 32, 64)
QUICK_HEIGHTS = (8, 16, 32)
JUDGED_HEIGHT = 32


def run_channel(*, walls: str, height: int) -> Result:
    """Return the largest error of a steady channel, ``height`` nodes across, between ``WALLS``."""
    wall = WALLS[walls]
    boundaries = Boundaries(left=Periodic(), right=Periodic(), bottom=wall, top=wall)
    return {"error": measure_poiseuille_error(height, boundaries)}


def _label(walls: str, height: int) -> str:
    return f"{walls}, H = {height}"


def make_jobs(quick: bool) -> list[Job]:
    """Return a run for each kind of wall and height."""
    return [
        Job(
            _label(walls, height),
            run_channel,
            {"walls": walls, "height": height},
            cost=2e4 * height**2,  # steps grow as H²; a few nodes, so a step costs the same
        )
        for walls in WALLS
        for height in (QUICK_HEIGHTS if quick else HEIGHTS)
    ]


def _read(results: Results, walls: str) -> dict[int, float]:
    runs = select(results, {height: _label(walls, height) for height in HEIGHTS})
    return {height: run["error"] for height, run in runs.items()}


def judge(results: Results) -> Sequence[Check]:
    """Judge order and error for each kind of wall."""
    checks = []
    for walls in WALLS:
        errors, lost = _read(results, walls), 0 if walls == HALF_WAY else 1
        checks += [
            Check(
                quantity=f"order of the profile error, {walls}",
                ours=fit_order({n - lost: e for n, e in errors.items()}),
                reference=2.0,
                source="second-order method",
                tolerance=0.1,
                is_absolute=True,
                resolution=f"H = {min(errors)}–{max(errors)}",
            ),
            Check(
                quantity=f"largest profile error / peak, {walls}",
                ours=errors[JUDGED_HEIGHT],
                reference=(0.0, 1e-3),
                source="own criterion",
                resolution=f"H = {JUDGED_HEIGHT}",
                refinement={f"H = {n}": e for n, e in errors.items()},
            ),
        ]
    return checks


def draw(results: Results) -> Figure:
    """Draw the error against resolution."""
    figure = Figure(figsize=(5.6, 3.8), layout="constrained")
    axes = figure.subplots()
    draw_convergence(axes, {walls: _read(results, walls) for walls in WALLS})
    axes.set(xlabel="nodes H across the channel", ylabel="largest error / peak speed")
    axes.set_title("Poiseuille flow driven by a body force, τ = 0.9", loc="left")
    return figure


SOURCE = "exact parabola"
CASE = Case("poiseuille", __doc__, SOURCE, make_jobs, judge, draw)
