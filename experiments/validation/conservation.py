"""Conservation.

A cylinder of diameter D sways by ±D along a closed tank of 6 D × 4 D between walls of half-way
bounce-back, from rest at its turning point, for three periods (largest speed U = 0.06, τ = 0.6).
The density is averaged over the nodes outside the cylinder: water that the skin or nodes that
change sides gain or lose changes this mean, and the pressure everywhere.
"""

from collections.abc import Iterator
from math import pi

import numpy as np
import torch
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.wake import make_even, start_flow
from fishrl.physics import Boundaries, Cylinder, FlowConfig, NoSlip, Oscillating
from fishrl.physics.skins import Skin
from fishrl.settings import build

SPEED = 0.06
NUM_PERIODS = 3
NUM_SAMPLES = 100  # per period
DIAMETERS = (12, 24)
SKINS = ("bounce-back", "immersed-boundary")


def sway(*, diameter: int, skin: str) -> Result:
    """Return the mean of rho - 1 outside the cylinder, ``NUM_SAMPLES`` times a period."""
    interval = make_even(2.0 * pi * diameter / SPEED / NUM_SAMPLES)  # steps between samples
    period = interval * NUM_SAMPLES
    wall = NoSlip()
    config = FlowConfig(
        width=6 * diameter,
        height=4 * diameter,
        tau=0.6,
        bodies=(Cylinder(diameter=diameter, motion=Oscillating(sway=(diameter, 0.0))),),
        skin=build(Skin, skin),
        boundaries=Boundaries(left=wall, right=wall, bottom=wall, top=wall),
    )
    place = (0.5 * config.width + diameter - 0.2, 0.5 * config.height - 0.3)
    solver = start_flow(config, place, frequency=1.0 / period)
    solver.body.phase.fill_(0.5 * pi)
    x, y = torch.arange(config.width), torch.arange(config.height)[:, None]
    means = []
    for _ in range(NUM_PERIODS * NUM_SAMPLES):
        solver.advance_(interval)
        to_x, to_y = x - solver.body.position[0, 0], y - solver.body.position[0, 1]
        is_outside = to_x**2 + to_y**2 > (0.5 * diameter) ** 2
        drho = solver.populations()[0].double().sum(0)
        means.append(float(drho[is_outside].mean()))
    return {"mean": means}


JOBS = [
    Job(sway, {"diameter": d, "skin": skin}, cost=2e4 * d**3, is_quick=d == min(DIAMETERS))
    for skin in SKINS
    for d in DIAMETERS
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check the water gained in each period, and how steady the pressure is."""
    for skin in SKINS:
        means = {d: np.array(m) for d, m in runs.read("mean", "diameter", skin=skin).items()}
        ends = {d: [0.0, *m[NUM_SAMPLES - 1 :: NUM_SAMPLES]] for d, m in means.items()}
        gained = {d: float(np.abs(np.diff(values)).max()) for d, values in ends.items()}
        unsteady = {d: float(m.std() / 3.0 / SPEED**2) for d, m in means.items()}
        for name, values, limit in (
            ("largest change of the mean density in a period", gained, 1e-4),
            ("standard deviation of the mean pressure / ρU²", unsteady, 1e-3),
        ):
            criterion = ((0.0, limit), "own criterion") if skin == SKINS[0] else ()
            yield check_refined("D", f"{name}, {skin}", values, *criterion, at=min(DIAMETERS))


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the mean density against time."""
    axes = figure.subplots()
    for skin in SKINS:
        for d, mean in runs.read("mean", "diameter", skin=skin).items():
            time = (np.arange(len(mean)) + 1) / NUM_SAMPLES
            axes.plot(time, np.array(mean) * 1e6, label=f"D = {d}, {skin}")
    axes.set(xlabel="time t / T", ylabel="mean of ρ − 1, 10⁻⁶")
    axes.set_title("Cylinder that sways by ±D in a closed tank")


CASE = Case("conservation", __doc__, "conservation of mass", JOBS, judge, draw)
