"""Cylinder in an unbounded stream.

The domain has height H, from 20 D to 60 D. The cylinder lies H / 2 behind an inflow of uniform
velocity U, and the outflow is at least 20 D behind it. Sides and outflow are open to sound. Markers
lie 0.45 nodes inside the outline; the no-slip condition is solved directly. Of 50 to 140 D / U, the
last 40 % are evaluated over whole periods. The acceptance criteria apply to values extrapolated to
a fine grid, Mach number zero and D / H = 1 / 100, the blockage of the domains used in the
references. The extrapolation uses two greater heights at D = 16, and D = 16 and 32 at both U and U
/ 2. The wake length L_w extends from the rear stagnation point to the end of reversed flow on the
axis.
"""

from collections.abc import Iterator, Mapping
from math import prod
from typing import Any

from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.wake import draw_vorticity, kick, measure_wake, start_stream
from fishrl.physics import Cylinder, Fixed

Setup = tuple[int, int, float]

TRAVELS = {20: 50.0, 40: 70.0, 100: 140.0, 200: 120.0}  # by Reynolds number
# D, height / D, U
BASE, FINE, SLOW, FINE_SLOW = (16, 20, 0.1), (32, 20, 0.1), (16, 20, 0.05), (32, 20, 0.05)
TALL, TALLER = (16, 40, 0.1), (16, 60, 0.1)
SETUPS = (BASE, FINE, SLOW, FINE_SLOW, TALL, TALLER)
BLOCKAGE = 0.01  # D / H of the judged value: that of the references' own domains, 60 to 120 D
SHEDDING = (100, 200)
# Ranges of what others found without walls, as third parties quote them.
ROUND_20 = "Dennis & Chang 1970, Fornberg 1980, Giannetti & Luchini 2007, Wu & Shu 2009"
ROUND_40 = "range quoted with Gautier, Biau & Lamballais 2013, who found 1.4931 and 2.2360"
ROUND_100 = (
    "Kim, Liu et al. 1998, Park, Calhoun, Russell & Wang 2003, Choi, Wu & Shu 2009, Qu et al. 2013"
)
LARGE = "eight codes in large domains, Qu et al. 2013"
ROUND_200 = "Braza et al. 1986, Henderson 1995, Rosenfeld, Wright & Smith, Barbeau 2022"
REFERENCES = (
    (20, "drag", "C_d", (2.00, 2.09), ROUND_20),
    (20, "wake_length", "L_w / D", (0.91, 0.94), ROUND_20),
    (40, "drag", "C_d", (1.48, 1.62), ROUND_40),
    (40, "wake_length", "L_w / D", (2.13, 2.35), ROUND_40),
    (100, "drag", "C_d", (1.31, 1.38), ROUND_100),
    (100, "lift_amplitude", "C_l amplitude", (0.30, 0.344), ROUND_100),
    (100, "strouhal", "St", (0.164, 0.166), LARGE),
    (200, "drag", "C_d", (1.31, 1.40), ROUND_200),
    (200, "lift_amplitude", "C_l amplitude", (0.65, 0.75), ROUND_200),
    (200, "strouhal", "St", (0.19, 0.20), ROUND_200),
)
NOTES = {
    (20, "wake_length"): (
        "the wake is only 15 to 30 nodes long, and markers 0.45 nodes inside the outline place "
        "its surface to about a tenth of a node, about the size of the deviation."
    )
}
VIEW_D = (-3.0, 15.0, -4.0, 4.0)  # left, right, low, high


def run_cylinder(*, diameter: int, height: int, reynolds: int, speed: float) -> Result:
    """Run a cylinder in a box ``height`` D high.

    Returns the results of ``measure_wake``, and the length of a steady wake / D.
    """
    is_shedding = reynolds in SHEDDING
    upstream, downstream = height // 2, max(20, height // 2)
    x, y = upstream * diameter, height * diameter // 2
    motion = kick(speed, diameter) if is_shedding else Fixed()
    solver = start_stream(
        Cylinder(diameter=diameter, motion=motion),
        (x, y),
        size=((upstream + downstream) * diameter + 1, height * diameter + 1),
        tau=3.0 * (speed * diameter / reynolds) + 0.5,
        speed=speed,
    )
    left, right, low, high = VIEW_D
    travels = 0.6 * TRAVELS[reynolds], 0.4 * TRAVELS[reynolds]
    window = upstream + left, upstream + right, 0.5 * height + low, 0.5 * height + high
    result = measure_wake(solver, travels, window, is_shedding=is_shedding)
    if not is_shedding:
        u = solver.macroscopic()[1][0, 0, y]
        result["wake_length"] = _measure_wake_length(u, x + 0.5 * diameter) / diameter
    return result


def _measure_wake_length(u: Tensor, rear: float) -> float:
    """Return how far behind the rear stagnation point the flow along the axis stops returning."""
    values: list[float] = u.double().tolist()
    start = round(rear) + 2
    at = next(i for i in range(start, len(values)) if values[i - 1] < 0.0 <= values[i])
    return at - values[at] / (values[at] - values[at - 1]) - rear


JOBS = [
    Job(
        run_cylinder,
        {"diameter": diameter, "height": height, "reynolds": reynolds, "speed": speed},
        cost=1.5 * height**2 * TRAVELS[reynolds] * diameter**3 / speed,
    )
    for reynolds in TRAVELS
    for diameter, height, speed in SETUPS
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check what is left without walls."""
    for reynolds, key, name, *criterion in REFERENCES:
        values = {s: _get(runs, reynolds, s)[key] for s in SETUPS}
        shown = {f"D = {d}, H = {h} D, U = {u}": value for (d, h, u), value in values.items()}
        shown["extrapolated"], note = extrapolate(values), NOTES.get((reynolds, key), "")
        options: Any = {"at": "extrapolated", "note": note}
        yield check_refined("", f"{name}, Re = {reynolds}", shown, *criterion, **options)


def _get(runs: Runs, reynolds: int, setup: Setup) -> Result:
    diameter, height, speed = setup
    return runs.get(diameter=diameter, height=height, reynolds=reynolds, speed=speed)


def extrapolate(values: Mapping[Setup, float]) -> float:
    """Return a quantity by ``SETUPS`` in a wide domain, on a fine grid, at no Mach number.

    Of height: a parabola in D / H through three heights at D = 16 (Qu et al. 2013 find their C_d
    linear in it). Of resolution and speed: 1 / D^2 at each speed first, then U^2; the error of the
    body's surface depends on both, as the relaxation time does.
    """
    heights = {setup: 1.0 / setup[1] for setup in (BASE, TALL, TALLER)}
    wide = 0.0
    for setup, height in heights.items():
        others = [h for h in heights.values() if h != height]
        wide += values[setup] * prod((BLOCKAGE - h) / (height - h) for h in others)
    ratio = (FINE[0] / BASE[0]) ** 2 - 1.0
    fast, slow = (
        values[fine] + (values[fine] - values[coarse]) / ratio
        for coarse, fine in ((BASE, FINE), (SLOW, FINE_SLOW))
    )
    exact = slow + (slow - fast) / ((BASE[2] / SLOW[2]) ** 2 - 1.0)
    return wide * exact / values[BASE]


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the wakes."""
    for axes, reynolds in zip(figure.subplots(2, 2).flat, TRAVELS, strict=True):
        draw_vorticity(axes, _get(runs, reynolds, TALL), VIEW_D, limit=3.0)
        axes.set_title(f"Re = {reynolds}, D = {TALL[0]} nodes, H = {TALL[1]} D")


SOURCE = "ranges of published values, as quoted in secondary sources"
CASE = Case(
    "free-cylinder", __doc__, SOURCE, JOBS, judge, draw, (9.6, 4.6), headline="C_d, Re = 100"
)
