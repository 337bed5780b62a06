"""Poiseuille flow.

A channel H nodes wide, periodic along x, is driven by a uniform body force with τ = 0.9 and a peak
speed of 1.6 / H. Its walls are either half-way bounce-back, half a node outside the edge nodes, or
non-equilibrium extrapolation, on the edge nodes. The readable step runs for six decay times of the
slowest mode. The error is the largest difference from the parabola relative to its peak. Its order
refers to the distance of the walls: H node distances for the first kind, H − 1 for the second.
"""

from collections.abc import Iterator
from math import pi
from typing import Any

import torch
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import draw_convergence, fit_order
from fishrl.physics import Boundaries, FlowConfig, FlowState, NonEquilibrium, NoSlip, Periodic
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import make_params, make_uniform
from fishrl.physics.step import step

HALF_WAY = "half-way bounce-back"
WALLS = {HALF_WAY: NoSlip(), "non-equilibrium extrapolation": NonEquilibrium(velocity=(0.0, 0.0))}
HEIGHTS = (8, 16, 32, 64)
JUDGED_HEIGHT = 32


def run_channel(*, walls: str, height: int) -> Result:
    """Return the largest error of a steady channel, ``height`` nodes across, between ``WALLS``."""
    is_half_way, wall = walls == HALF_WAY, WALLS[walls]
    edges = Boundaries(left=Periodic(), right=Periodic(), bottom=wall, top=wall)
    config = FlowConfig(width=4, height=height, tau=0.9, boundaries=edges)
    outside = 0.5 if is_half_way else 0.0  # where the walls stand
    y = torch.arange(height, dtype=torch.float64) + outside
    gap, peak = height - 1.0 + 2.0 * outside, 1.6 / height
    force = torch.zeros(1, 2, height, 4, dtype=torch.float64)
    force[:, 0] = 8.0 * config.nu * peak / gap**2
    exact = 4.0 * peak * y * (gap - y) / gap**2
    rest = torch.zeros(1, height, 4, dtype=torch.float64)
    state, params = (
        FlowState(make_uniform(rest, rest + exact[:, None], rest)),
        make_params([config]),
    )
    for _ in range(int(6.0 * gap**2 / (pi**2 * config.nu))):  # six decay times of the slowest mode
        state = step(state, config, params, external_force=force)
    u = compute_macroscopic(state.f.unbind(1)).ux[0, :, 0] + 0.5 * force[0, 0, :, 0]
    inner = slice(None) if is_half_way else slice(1, -1)
    return {"error": float((u - exact)[inner].abs().max() / peak)}


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
