"""Half disc: the three flows of the Kármán gait.

The domain is that of the paper, 25 D × 12.5 D (1000 × 500 nodes with D = 40; blockage 8 %), with
the flat side of the half disc 6.25 D behind the inflow. Streams of 0.1, 0.125 and 0.15 nodes per
step give Re = 200, 250 and 300 (conditions I, II, III). The flat side faces downstream, and the
edges are those of `Boundaries.make_stream`. Markers lie 0.45 nodes inside the outline; the
no-slip condition is solved directly. After a perturbation the flow runs for 120 D / U, of which the
second half is evaluated over whole periods. St = f D / U is that of the lift, from its zero
crossings and from its spectrum. Variants at D = 20 have sides that move with the stream, open
sides, no-slip walls, half the speed at the same Re, the flat side upstream, or a fixed density at
the outflow.
"""

from collections.abc import Iterator, Mapping
from math import pi
from typing import Any

from matplotlib.figure import Figure

from experiments.validation import wake
from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from fishrl.physics import DCylinder, NoSlip
from fishrl.physics.skins import DirectSolve, ImmersedBoundary

WIDTH_D, HEIGHT_D, FACE_D = 25.0, 12.5, 6.25  # 1000 x 500 nodes, face at x = 250, with D = 40
WINDOW_D = (4.0, 22.0, 2.0, 10.5)  # of the picture: left, right, low, high
SPEEDS = {200: 0.1, 250: 0.125, 300: 0.15}  # conditions I, II, III
PAPER = {200: 0.267, 250: 0.256, 300: 0.267}
SIZES = (20, 40)
TRAVELS = 120.0
SIDES = {
    "sliding sides": wake.SLIDING,
    "moving sides": wake.STREAM,
    "open sides": wake.OPEN_SIDE,
    "walls": NoSlip(),
}
VARIANTS: Mapping[str, dict[str, str | bool | float]] = {
    "moving sides": {"sides": "moving sides"},
    "open sides": {"sides": "open sides"},
    "walls": {"sides": "walls"},
    "half the speed": {"slowing": 2.0},
    "half the speed, open sides": {"slowing": 2.0, "sides": "open sides"},
    "flat side upstream": {"is_flat_downstream": False},
    "pinned outlet": {"is_pinned": True},
}
RUNS = {f"D = {size}": {"diameter": size} for size in SIZES} | {
    f"D = 20, {name}": {"diameter": 20, **variant} for name, variant in VARIANTS.items()
}
QUANTITIES = {
    "strouhal": "St by zero crossings",
    "spectral": "St by spectrum",
    "drag": "C_d",
    "lift_amplitude": "C_l amplitude",
}
NOTE = (
    "the paper's shedding frequencies are exactly 1/1500, 1/1250 and 1/1000 per step: bins 10, 12 "
    "and 15 of a spectrum of 15000 steps, 7 to 10 % apart. The paper states neither how they were "
    "determined nor which way the half disc faces. We found no other measured value at these Re."
)


def run_half_disc(
    *,
    diameter: int,
    reynolds: int,
    sides: str = "sliding sides",
    is_flat_downstream: bool = True,
    slowing: float = 1.0,
    is_pinned: bool = False,
) -> Result:
    """Run a half disc in the paper's domain until its wake repeats itself; see ``measure_wake``.

    The stream is ``slowing`` times slower, in nodes per step, than in the paper.
    """
    speed = SPEEDS[reynolds] / slowing
    width, height = round(WIDTH_D * diameter), round(HEIGHT_D * diameter)
    centre = -1.0 if is_flat_downstream else 1.0  # 2 D / (3 pi) from the flat side
    x = FACE_D * diameter + centre * 2.0 * diameter / (3.0 * pi)
    solver = wake.start_stream(
        DCylinder(diameter=diameter, motion=wake.kick(speed, diameter)),
        (x, 0.5 * (height - 1)),
        pi if is_flat_downstream else 0.0,
        size=(width, height),
        tau=3.0 * (speed * diameter / reynolds) + 0.5,
        speed=speed,
        outflow=wake.PINNED if is_pinned else wake.OPEN,
        sides=SIDES[sides],
        skin=ImmersedBoundary(force_solve=DirectSolve()),
    )
    return wake.measure_wake(solver, (0.5 * TRAVELS, 0.5 * TRAVELS), WINDOW_D)


JOBS = [
    Job(
        run_half_disc,
        {"reynolds": reynolds, **run},
        cost=WIDTH_D * HEIGHT_D * TRAVELS * size**3 / SPEEDS[reynolds],
    )
    for reynolds in SPEEDS
    for run in RUNS.values()
    for size in [int(run["diameter"])]
]


def judge(runs: Runs) -> Iterator[Check]:
    """Compare the measurements with the paper, without a criterion."""
    for reynolds in SPEEDS:
        for key, name in QUANTITIES.items():
            row = {n: runs.get(reynolds=reynolds, **a)[key] for n, a in RUNS.items()}
            paper: Any = (PAPER[reynolds], "the paper's table") if key == "strouhal" else ()
            options = {"at": f"D = {max(SIZES)}", "note": NOTE if paper else ""}
            yield check_refined("", f"{name}, Re = {reynolds}", row, *paper, **options)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the wakes and the lift."""
    shape: Any = [[str(reynolds) for reynolds in SPEEDS], ["lift"] * len(SPEEDS)]
    panels = figure.subplot_mosaic(shape, height_ratios=(3, 2))
    lift, size = panels["lift"], max(SIZES)
    left, right, low, high = WINDOW_D
    reach = (left - FACE_D, right - FACE_D, low - 0.5 * HEIGHT_D, high - 0.5 * HEIGHT_D)
    for reynolds in SPEEDS:
        axes, run = panels[str(reynolds)], runs.get(reynolds=reynolds, diameter=size)
        wake.draw_vorticity(axes, run, reach, limit=5.0)
        axes.set_title(f"Re = {reynolds}, D = {size} nodes")
        wake.draw_series(lift, run, "lift", f"Re = {reynolds}")
    lift.set(xlabel="time  [D / U]", ylabel="lift coefficient")
    figure.legend(*lift.get_legend_handles_labels(), loc="outside lower center", ncols=3)


SOURCE = "none; the shedding frequencies in the paper's table are listed for comparison"
CASE = Case("d-cylinder", __doc__, SOURCE, JOBS, judge, draw, size=(12.0, 5.0))
