"""Cylinder in an unbounded stream.

Box of height H, 20 D to 60 D; the cylinder stands H / 2 behind an inflow of uniform velocity U, and
the outflow 20 D or more behind it. Sides and outflow let sound out. Markers lie 0.45 nodes inside
the outline, no slip is solved exactly. 50 to 140 D / U, of which the last 40 % are measured, over
whole periods. Judged is the value on a fine grid, at no Mach number and at D / H = 1 / 100, the
blockage of the references' own domains: by two larger heights at D = 16, and by D = 16 and 32 at
both U and U / 2. The wake length L_w runs from the rear stagnation point to where the flow on the
axis stops returning.
"""

from collections.abc import Mapping, Sequence
from math import prod

from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation.case import Case, Check, Job, Result, Results, select
from experiments.validation.wake import draw_vorticity, make_even, measure_wake, start_flow
from fishrl.physics import Boundaries, Cylinder, Fixed, FlowConfig, NonEquilibrium, OpenEdge
from fishrl.physics.immersed_boundary import DirectSolve

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
ROUND_40 = "range quoted beside Gautier, Biau & Lamballais 2013, who found 1.4931 and 2.2360"
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
NOTES: Mapping[tuple[int, str], str] = {
    (20, "wake_length"): (
        "the wake is 15 to 30 nodes long here and begins at a surface that markers 0.45 nodes "
        "inside place to about a tenth of a node, which is about what is missing; D = 32, a third "
        "height and half the speed were tried and left it there."
    ),
}
VIEW_D = (-3, 15, -4, 4)  # left, right, low, high


def run_cylinder(*, diameter: int, height: int, reynolds: int, speed: float) -> Result:
    """Run a cylinder, D nodes wide, in a box ``height`` D high, open but for the inflow.

    The cylinder stands half the height behind the inflow of ``speed`` nodes per step. Returns those
    of ``measure_wake``, and the length of a steady wake / D.
    """
    nu = speed * diameter / reynolds
    is_shedding = reynolds in SHEDDING
    kick = Fixed(kick_speed=0.3 * speed, kick_steps=round(3 * diameter / speed))
    upstream, downstream = height // 2, max(20, height // 2)
    side = OpenEdge(is_plane=False)
    config = FlowConfig(
        width=(upstream + downstream) * diameter + 1,
        height=height * diameter + 1,
        tau=3.0 * nu + 0.5,
        stream_speed=speed,
        bodies=(Cylinder(diameter=diameter, motion=kick if is_shedding else Fixed()),),
        boundaries=Boundaries(
            left=NonEquilibrium(velocity=(1.0, 0.0)), right=OpenEdge(), bottom=side, top=side
        ),
        force_solve=DirectSolve(regularisation=0.0),
    )
    x, y = upstream * diameter, height * diameter // 2
    solver = start_flow(config, (x, y), stream=(1.0, 0.0))
    left, right, low, high = (side * diameter for side in VIEW_D)
    result = measure_wake(
        solver,
        diameter=diameter,
        speed=speed,
        num_steps=(
            0.6 * TRAVELS[reynolds] * diameter / speed,
            0.4 * TRAVELS[reynolds] * diameter / speed,
        ),
        interval=make_even(diameter / speed / 30.0),
        window=(x + left, x + right, y + low, y + high),
        is_shedding=is_shedding,
    )
    if not is_shedding:
        u = solver.macroscopic()[1][0, 0, y]
        result["wake_length"] = _measure_wake_length(u, x + 0.5 * diameter) / diameter
    return result


def _measure_wake_length(u: Tensor, rear: float) -> float:
    """Return how far behind the rear stagnation point the flow along the axis stops returning."""
    values = u.double().tolist()
    start = round(rear) + 2
    at = next(i for i in range(start, len(values)) if values[i - 1] < 0.0 <= values[i])
    return at - values[at] / (values[at] - values[at - 1]) - rear


def _name(setup: Setup) -> str:
    diameter, height, speed = setup
    return f"D = {diameter}, H = {height} D, U = {speed}"


def _label(reynolds: int, setup: Setup) -> str:
    return f"Re = {reynolds}, {_name(setup)}"


def make_jobs(quick: bool) -> list[Job]:
    """Return a run per Reynolds number, and what resolution, height and speed change."""
    runs = [(re, setup) for re in TRAVELS for setup in SETUPS]
    return [
        Job(
            _label(re, (diameter, height, speed)),
            run_cylinder,
            {"diameter": diameter, "height": height, "reynolds": re, "speed": speed},
            cost=1.5 * height**2 * TRAVELS[re] * diameter**3 / speed,
        )
        for re, (diameter, height, speed) in ([(40, BASE), (100, BASE)] if quick else runs)
    ]


def judge(results: Results) -> Sequence[Check]:
    """Judge what is left without walls; a quick run shows its numbers without judging."""
    checks = []
    for reynolds, key, name, reference, source in REFERENCES:
        runs = select(results, {setup: _label(reynolds, setup) for setup in SETUPS})
        values = {setup: run[key] for setup, run in runs.items()}
        shown = {_name(setup): value for setup, value in values.items()}
        if len(values) == len(SETUPS):
            ours = extrapolate(values)
            checks.append(
                Check(
                    quantity=f"{name}, Re = {reynolds}",
                    ours=ours,
                    reference=reference,
                    source=source,
                    resolution="extrapolated",
                    refinement=shown | {"extrapolated": ours},
                    note=NOTES.get((reynolds, key), ""),
                )
            )
        elif values:
            checks.append(
                Check(
                    quantity=f"{name}, Re = {reynolds}, with walls", ours=values[BASE],
                    source=source, resolution=_name(BASE), refinement=shown,
                )
            )  # fmt: skip
    return checks


def extrapolate(values: Mapping[Setup, float]) -> float:
    """Return a quantity in a wide domain, on a fine grid, at no Mach number.

    Of height: a parabola in D / H through three heights at D = 16 (Qu et al. 2013 find their C_d
    linear in it). Of resolution and speed: 1 / D^2 at each speed first, then U^2; the error of the
    body's surface depends on both, as the relaxation time does.

    Args:
        values: by the entries of ``SETUPS``.
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


def draw(results: Results) -> Figure:
    """Draw the wakes."""
    setup = TALL if any(_label(re, TALL) in results for re in TRAVELS) else BASE
    runs = select(results, {re: _label(re, setup) for re in TRAVELS})
    figure = Figure(figsize=(9.6, 4.6), layout="constrained")
    panels = list(figure.subplots(2, 2).flat)
    for axes, (reynolds, run) in zip(panels, runs.items(), strict=False):
        draw_vorticity(axes, run["vorticity"], VIEW_D, limit=3.0)
        axes.set_title(f"Re = {reynolds}, D = {setup[0]} nodes, H = {setup[1]} D", loc="left")
    for axes in panels[len(runs) :]:
        axes.set_visible(False)
    return figure


SOURCE = "what others found, as third parties quote them: the range of each number"
CASE = Case("free-cylinder", __doc__, SOURCE, make_jobs, judge, draw)
