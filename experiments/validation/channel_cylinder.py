"""Cylinder in a channel (Schäfer–Turek 2D-1 and 2D-2).

The channel is 22 D long and 4.1 D high, with half-way bounce-back walls. The cylinder lies 2 D
behind a parabolic inflow and 2 D above the lower wall. Re and coefficients are based on the mean
speed, 2/3 of the peak U = 0.05, and on the density at the inflow. The outflow is open to plane
sound waves. Markers lie 0.45 nodes inside the outline; the no-slip condition is solved directly.
The flow starts as Poiseuille flow with its pressure, at Re = 100 with a perturbation of the
cylinder, and runs for 60 and 80 D / U_mean, of which the second half is evaluated over whole
periods. The surface pressure is extrapolated by a parabola through the second, third and fourth
nodes outside the surface.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation import wake
from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import GREY
from fishrl.physics import Cylinder, Fixed, compute_pressure
from fishrl.physics.boundaries import NonEquilibrium, NoSlip, OpenEdge, Profile
from fishrl.physics.collision import compute_equilibrium

LENGTH_D, HEIGHT_D, PLACE_D, VIEW_D = 22.0, 4.1, 2.0, 10.0
MEAN = 2.0 / 3.0  # mean over peak speed of a parabola
SPEED = 0.05
MEAN_SPEED = {20: 0.2, 100: 1.0}  # of the benchmark, m/s, which gives its pressures
INFLOW = NonEquilibrium(velocity=(1.0, 0.0), profile=Profile.PARABOLA)
SIZES = (20, 40, 60)
VARIANTS: Mapping[str, Mapping[str, float | bool]] = {
    "standard": {},
    "U = 0.1": {"speed": 0.1},
    "markers on the outline": {"inset": 0.0},
    "pinned outlet": {"is_pinned": True},
}
TRAVELS = {20: 60.0, 100: 80.0}  # by Reynolds number
INTERVALS = "Schäfer & Turek 1996"
NABH = "Nabh 1998, spectral"
FEATFLOW = "FeatFlow, level 6"
FINER = "the interval of 1996 does not contain the value of later, finer computations, 0.9866."
ORGAN_PIPE = (
    "between an inflow of fixed velocity and an outflow of fixed density, sound forms standing "
    "waves with frequencies close to that of the drag."
)
# quantity, Reynolds number, name in the results, reference, source, tolerance, note
TARGETS = (
    ("C_d, Re = 20", 20, "drag", 5.57953523, NABH, 0.015, ""),
    ("C_l, Re = 20", 20, "lift", 0.01061895, NABH, None, ""),
    ("Δp [Pa], Re = 20", 20, "pressure_drop", 0.11752017, NABH, None, ""),
    ("C_d,max, Re = 100", 100, "drag_max", (3.22, 3.24), INTERVALS, 0.03, ""),
    ("C_l,max, Re = 100", 100, "lift_max", (0.99, 1.01), INTERVALS, 0.03, FINER),
    ("St, Re = 100", 100, "strouhal", (0.295, 0.305), INTERVALS, 0.015, ""),
    ("C_d,max, Re = 100, finer reference", 100, "drag_max", 3.227393, FEATFLOW, None, ""),
    ("C_l,max, Re = 100, finer reference", 100, "lift_max", 0.986571, FEATFLOW, None, ""),
    ("C_l, peak to peak, Re = 100", 100, "lift_swing", 2.007871, FEATFLOW, None, ""),
    ("St, Re = 100, finer reference", 100, "strouhal", 0.30184, FEATFLOW, None, ""),
)
VARIANT_TARGETS = (
    ("C_d, Re = 20", 20, "drag", 5.57953523, NABH, ""),
    ("C_d,max, Re = 100", 100, "drag_max", 3.227393, FEATFLOW, ""),
    ("C_d, peak to peak, Re = 100", 100, "drag_swing", 0.063129, FEATFLOW, ORGAN_PIPE),
)
FORCE_EXTREMES = (0.986571, -1.021288, 0.227393, 0.164264)  # C_l and C_d - 3, FeatFlow


def run_channel(
    *,
    diameter: int,
    reynolds: int,
    speed: float = SPEED,
    inset: float = 0.45,
    is_pinned: bool = False,
) -> Result:
    """Run the benchmark from a developed channel flow; ``diameter`` is a multiple of 10 nodes.

    Returns the results of ``measure_wake``, and the pressure drop in Pa.
    """
    mean, is_shedding = MEAN * speed, reynolds == 100
    motion = wake.kick(mean, diameter, travels=1.0) if is_shedding else Fixed()
    width, height = round(LENGTH_D * diameter) + 1, round(HEIGHT_D * diameter)
    x, y = PLACE_D * diameter, PLACE_D * diameter - 0.5  # the walls stand half a node outside
    solver = wake.start_stream(
        Cylinder(diameter=diameter, inset=inset, motion=motion),
        (x, y),
        size=(width, height),
        tau=3.0 * (mean * diameter / reynolds) + 0.5,
        speed=speed,
        inflow=INFLOW,
        outflow=wake.PINNED if is_pinned else OpenEdge(profile=Profile.PARABOLA),
        sides=NoSlip(),
    )
    solver.set_populations_(_develop_channel(width, height, speed, solver.config.nu))
    travels, window = (0.5 * TRAVELS[reynolds],) * 2, (0.0, VIEW_D, 0.0, HEIGHT_D)
    options: Any = {"mean": MEAN, "is_shedding": is_shedding, "per_travel": 60.0}
    result = wake.measure_wake(solver, travels, window, **options)
    drop = _measure_pressure_drop(solver.macroscopic()[0][0], x, y, diameter)
    unit = result["inflow_density"] * mean**2
    return result | {"pressure_drop": MEAN_SPEED[reynolds] ** 2 * drop / unit}


def _develop_channel(width: int, height: int, speed: float, nu: float) -> Tensor:
    """Return populations of Poiseuille flow with its pressure, so that the start makes no sound."""
    y = (torch.arange(height, dtype=torch.float64) + 0.5) / height
    x = torch.arange(width, dtype=torch.float64)
    slope = 3.0 * 8.0 * nu * speed / height**2
    u = (4.0 * speed * y * (1.0 - y))[None, :, None].expand(1, height, width)
    rho = (slope * (width - 1 - x))[None, None].expand(1, height, width)
    return torch.stack(compute_equilibrium(rho, u, 0.0 * u), 1).float()


def _measure_pressure_drop(rho: Tensor, x: float, y: float, diameter: int) -> float:
    """Return p in front of the cylinder less p behind it, on its surface.

    The kernel smears the pressure there: a parabola through the nodes 2, 3 and 4 outside gives it.
    """
    row = compute_pressure(rho[int(y) : int(y) + 2].double()).mean(0)  # y lies between two rows
    front, back = round(x - 0.5 * diameter), round(x + 0.5 * diameter)
    ends = [
        6.0 * row[at + 2 * step] - 8.0 * row[at + 3 * step] + 3.0 * row[at + 4 * step]
        for at, step in ((front, -1), (back, 1))
    ]
    return float(ends[0] - ends[1])


JOBS = [
    Job(
        run_channel,
        {"diameter": size, "reynolds": reynolds, **variant},
        cost=90.0 * TRAVELS[reynolds] * size**3 / (MEAN * SPEED),
        is_quick=size == SIZES[0] and not variant,
    )
    for reynolds in TRAVELS
    for size in SIZES
    for variant in (VARIANTS.values() if size == SIZES[0] else ({},))
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check drag, lift and Strouhal number, and show what the variants change."""
    for quantity, reynolds, key, *criterion, note in TARGETS:
        values = runs.read(key, "diameter", reynolds=reynolds)
        if note is not FINER or len(values) > 1:  # the lift of a quick run is known to be 9 % low
            yield check_refined("D", quantity, values, *criterion, note=note)
    for quantity, reynolds, key, reference, source, note in VARIANT_TARGETS:
        found = {v: runs.by("diameter", reynolds=reynolds, **VARIANTS[v]) for v in VARIANTS}
        row = {v: sizes[SIZES[0]][key] for v, sizes in found.items() if sizes}
        if len(row) > 1:
            size = f"D = {SIZES[0]}"
            options: Any = {"at": "standard", "resolution": size, "note": note}
            yield check_refined("", f"{quantity}, {size}", row, reference, source, **options)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the wake, the forces over time and the errors against resolution."""
    shedding = runs.by("diameter", reynolds=100)
    run = shedding[max(shedding)]
    grid = figure.add_gridspec(2, 2, height_ratios=(1.15, 1.0))
    axes = figure.add_subplot(grid[0, :])
    reach = (-PLACE_D, VIEW_D - PLACE_D, -PLACE_D, HEIGHT_D - PLACE_D)
    wake.draw_vorticity(axes, run, reach, limit=6.0)
    axes.set_title(f"Re = 100, D = {max(shedding)} nodes")
    axes = figure.add_subplot(grid[1, 0])
    wake.draw_series(axes, run, "lift", "C_l")
    wake.draw_series(axes, run, "drag", "C_d − 3", shift=-3.0)
    for value in FORCE_EXTREMES:
        axes.axhline(value, color=GREY, linestyle=":", linewidth=0.9)
    axes.set(xlabel="time  [D / U_mean]", ylabel="force coefficient")
    axes.set_title("Re = 100; dotted: extremes by FeatFlow")
    axes = figure.add_subplot(grid[1, 1])
    for quantity, reynolds, key, reference, *_ in (TARGETS[0], *TARGETS[6:8], TARGETS[9]):
        values = runs.read(key, "diameter", reynolds=reynolds)
        errors = [100.0 * (value / reference - 1.0) for value in values.values()]
        name = quantity.removesuffix(", finer reference")
        axes.plot([*values], errors, "o-", markerfacecolor="none", label=name)
    axes.axhline(0.0, color=GREY, linewidth=0.9)
    axes.set(xlabel="diameter D  [nodes]", ylabel="error  [%]", xticks=list(SIZES))
    axes.set_title("against Nabh and FeatFlow")


SOURCE = (
    "Schäfer & Turek 1996, NNFM 52, 547 (intervals); Nabh 1998 and the FeatFlow group's finest "
    "runs (numbers), all as quoted in secondary sources"
)
CASE = Case("channel-cylinder", __doc__, SOURCE, JOBS, judge, draw, size=(7.6, 6.2))
