"""Flow-coupled pitching pair.

Two rigid foils (NACA0008) pitch by ±15° about their leading edges with the same period T, the
follower 0 to 7/8 of a period later. The flow alone moves each along x; y is prescribed. Re =
2πρAfL/μ = 1645 with A = L sin 15°, trailing edge at 0.07 nodes per step. The domain is 16 L × 6 L,
with a stream that moves against the foils nearly as fast as they swim and edges open to sound. In
line, the follower starts 2.3 L behind the leader's trailing edge and settles at a distance; the
last 10 of 30 periods are averaged. Side by side, the leading edges start level, 3/4 L apart. Power
is that of the torques about the leading edges. All is repeated on a finer grid, which the figure
shows.
"""

from collections.abc import Iterator
from functools import partial
from math import pi, radians, sin
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.wake import OPEN, OPEN_SIDE, STREAM, make_even, record
from fishrl.physics import Boundaries, FlowConfig, Foil, ImmersedBoundary, InPlaceSolver, Surging

PITCH = radians(15.0)
REYNOLDS = 1645.0  # 2 pi rho A f L / mu, A = L sin(PITCH)
TIP_SPEED = 0.07  # nodes per step
STREAM_BL = 2.1  # L / T, about what a foil swims
SIZES = (40, 60)
FINER = max(SIZES)
NUM_PERIODS, NUM_MEASURED = 30, 10
NUM_SAMPLES = 50  # per period, of the power
LAGS = tuple(n / 8 for n in range(8))
GAP, OTHER_GAP = 2.3, 1.5  # L; from 1.5 L foils meet at some lags
ASIDE = 0.75  # L; nearer ones would touch in antiphase
NOTE = (
    "from 1.5 L at 180° the follower settles 0.4 L behind the leader, where it is a twentieth of a "
    "wavelength off the line of the places farther behind."
)


def swim(
    *, lag: float = 0.0, gap: float = 0.0, aside: float = 0.0, has_pair: bool = True, length: int
) -> Result:
    """Let a foil swim, or a pair with the second ``lag`` periods later.

    It starts ``gap`` L behind the first's trailing edge in line, or ``aside`` L next to it. Returns
    ``distance`` (L) from the first's trailing to the second's leading edge after each period, and
    of each foil the mean ``speed`` (L / T) and ``power`` (rho L^4 / T^3) in the measured periods.
    """
    size, tip = length, 2.0 * pi * sin(PITCH)
    interval = make_even(tip * size / TIP_SPEED / NUM_SAMPLES)
    period = interval * NUM_SAMPLES
    plain = Foil(chord=size, thickness=0.08)
    foil = Foil(chord=size, thickness=0.08, motion=Surging(pitch=PITCH, pivot=plain.centre))
    stream = STREAM_BL * size / period
    config = FlowConfig(
        width=16 * size,
        height=6 * size,
        tau=3.0 * tip * size**2 / period / REYNOLDS + 0.5,
        stream_speed=stream,
        bodies=(foil, foil) if has_pair else (foil,),
        skin=ImmersedBoundary(),
        boundaries=Boundaries(left=STREAM, right=OPEN, bottom=OPEN_SIDE, top=OPEN_SIDE),
    )
    solver = InPlaceSolver(config=config, num_envs=1, frequency=1.0 / period, num_workers=0)
    x = torch.tensor([0.0, 0.0 if aside else 1.0 + gap], dtype=torch.float64)
    y = torch.tensor([-0.5 * aside, 0.5 * aside], dtype=torch.float64)
    phase = torch.tensor([0.0, -2.0 * pi * lag], dtype=torch.float64)
    heading = pi + PITCH * torch.sin(phase)
    edge = torch.stack((5.0 * size + size * x, 0.5 * (config.height - 1) + size * y), -1)
    centre = edge - plain.centre * torch.stack((torch.cos(heading), torch.sin(heading)), -1)
    rows, num = torch.ones(1, dtype=torch.bool), len(config.bodies)
    solver.reset_(rows, centre[None, :num], heading[None, :num], velocity=(1.0, 0.0))
    for body, start in zip(solver.bodies, phase, strict=False):
        body.phase.fill_(start)
    read = record(solver, NUM_PERIODS * NUM_SAMPLES, interval, partial(_read, solver))
    angle, torque, force, nose = (value.numpy() for value in read)
    arm = -plain.centre * np.stack((np.cos(angle), np.sin(angle)), -1)
    turn, push, path = (np.diff(value, axis=0) for value in (angle, force, arm))
    spent = np.cumsum((np.diff(torque, axis=0) * turn - (push * path).sum(-1)) / interval, 0)
    every = slice(NUM_SAMPLES - 1, None, NUM_SAMPLES)  # at the end of each period
    energy, noses = spent[every] * (period**2 / size**4), nose[1:][every] / size
    first = -NUM_MEASURED - 1
    return {
        "distance": (noses[:, -1] - noses[:, 0] - 1.0).tolist(),
        "speed": (STREAM_BL - (noses[-1] - noses[first]) / NUM_MEASURED).tolist(),
        "power": ((energy[-1] - energy[first]) / NUM_MEASURED).tolist(),
    }


def _read(solver: InPlaceSolver) -> list[Tensor]:
    """Return heading, impulses of torque on the fluid and of force, and nose x of each foil."""
    parts = ((body.heading, body.torque_impulse, body.impulse) for body in solver.bodies)
    edges = [solver.markers(i)[0, 0, 0] for i in range(len(solver.bodies))]
    return [*map(torch.cat, zip(*parts, strict=True)), torch.stack(edges)]


RUNS: list[dict[str, Any]] = [
    *({"lag": lag, "gap": GAP, "length": size} for size in SIZES for lag in LAGS),
    *({"lag": lag, "gap": OTHER_GAP, "length": size} for size in SIZES for lag in (0.0, 0.5)),
    *({"lag": lag, "aside": ASIDE, "length": size} for size in SIZES for lag in (0.0, 0.5)),
    *({"has_pair": False, "length": size} for size in SIZES),
]
JOBS = [Job(swim, run, cost=96.0 * 23 * run["length"] ** 3 * NUM_PERIODS) for run in RUNS]


def find_spacings(runs: Runs, *, gap: float = GAP, **arguments: Any) -> dict[float, float]:
    """Return by lag the distance in units of U T, the mean over the measured periods."""
    return {
        lag: float(np.mean(run["distance"][-NUM_MEASURED:]) / np.mean(run["speed"]))
        for lag, run in runs.by("lag", gap=gap, **arguments).items()
    }


def fit_lags(spacings: dict[float, float]) -> tuple[float, float, dict[float, float]]:
    """Return slope and intercept of the spacing over the lag, and the spacings on one branch.

    Places one wavelength U T apart are alike, so that a spacing counts up to a whole number.
    """
    lags = np.array(list(spacings))
    values = np.array(list(spacings.values()))
    turn = np.angle(np.mean(np.exp(2j * pi * (values - lags)))) / (2.0 * pi)
    values -= np.round(values - lags - turn)
    slope, intercept = np.polyfit(lags, values, 1)
    return float(slope), float(intercept), dict(zip(lags.tolist(), values.tolist(), strict=True))


def judge(runs: Runs) -> Iterator[Check]:
    """Check the relation of spacing and lag, and the cost of transport side by side."""
    spacings = {size: find_spacings(runs, length=size) for size in SIZES}
    slopes = {size: fit_lags(found)[0] for size, found in spacings.items()}
    source = "Heydari, Hang & Kanso 2024, eLife 96129"
    slope = "slope of d / (U T) over φ / 2π"
    yield check_refined("L", slope, slopes, 1.0, source, 0.1)
    other = {size: find_spacings(runs, gap=OTHER_GAP, length=size) for size in spacings}
    for lag in other[FINER]:
        apart = {size: other[size][lag] - spacings[size][lag] for size in other}
        yield check_refined(
            "L",
            f"spacing from another start less that from {GAP} L, φ = {360 * lag:g}°",
            {size: value - round(value) for size, value in apart.items()},
            (-0.05, 0.05),
            "own criterion: equilibria do not depend on the start, up to whole wavelengths",
            note=NOTE if lag else "",
        )
    alone = runs.by("length", has_pair=False)
    yield check_refined(
        "L", "speed of a foil alone, L / T", {n: r["speed"][0] for n, r in alone.items()}
    )
    for lag, name, bounds in ((0.0, "in phase", (0.0, 1.0)), (0.5, "antiphase", (1.0, np.inf))):
        side_by_side = runs.by("length", aside=ASIDE, lag=lag)
        speeds, powers = (
            {n: float(np.mean(side_by_side[n][of]) / alone[n][of][0]) for n in alone}
            for of in ("speed", "power")
        )
        costs = {n: powers[n] / speeds[n] for n in alone}
        quantity = f"cost of transport side by side {name} / alone"
        yield check_refined("L", quantity, costs, bounds, source)
        yield check_refined("L", f"speed side by side {name} / alone", speeds)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the distance against time, and the spacing against the lag."""
    left, right = figure.subplots(1, 2)
    found = runs.by("lag", gap=GAP, length=FINER)
    for lag, run in found.items():
        left.plot(range(1, NUM_PERIODS + 1), run["distance"], label=f"φ = {360 * lag:g}°")
    left.set(xlabel="time t / T", ylabel="distance d / L", ylim=(0.0, None))
    left.legend(ncols=2, fontsize=7)
    slope, intercept, spacings = fit_lags(find_spacings(runs, length=FINER))
    lags = np.array(list(spacings))
    right.plot(360 * lags, list(spacings.values()), "o")
    right.plot(360 * lags, intercept + slope * lags, label=f"slope {slope:.2f}")
    right.plot(360 * lags, intercept + lags, "--", color="black", label="slope 1")
    right.set(xlabel="lag φ of the follower  [°]", ylabel="d / (U T), up to whole numbers")
    right.legend()


SOURCE = (
    "Heydari, Hang & Kanso 2024, eLife 96129: pitching foils at Re = 2πρAfL/μ = 1645; in line they "
    "settle at distances that rise linearly with the phase lag, side by side in phase they need "
    "less power per distance than alone, in antiphase more. The thickness of the foils and "
    "the lateral distance are our choice, so only trends are compared"
)
CASE = Case("pitching-pair", __doc__, SOURCE, JOBS, judge, draw, size=(9.0, 3.8))
