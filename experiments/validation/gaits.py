"""Gait library.

A free NACA0012 fish of L = 100 swims from rest with every gait of the library at Re = L² / (T ν) =
500 (the paper's Task 2) and 7142 (Tasks 0 and 1), and with Carling's gait at Reynolds numbers in
between. The speed is taken in the tenth beat; the tail speed is 0.07 nodes per step throughout. The
cost of transport is the muscle power divided by ρ L² U, in L / T². The swimming number is Sw = 2π
a(1) L² / (T ν); the Reynolds number of the motion is U L / ν.
"""

from collections.abc import Iterator
from math import pi

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Result, Runs
from experiments.validation.plots import GREY, fit_order, name_ticks
from experiments.validation.swimmer import draw_speed, make_swim
from fishrl.physics.bodies.gait import GAITS
from fishrl.programs.figures.style import COLOURS

BODY_LENGTH, NUM_BEATS = 100, 10
REYNOLDS = (500, 1000, 2000, 4000, 7142)
ENDS = (500, 7142)
EXPONENT = 4.0 / 3.0
SOURCE = "Gazzola, Argentina & Mahadevan 2014, Nature Phys. 10, 758: Re ∝ Sw^(4/3), laminar"


JOBS = [
    make_swim(BODY_LENGTH, NUM_BEATS, gait=gait, reynolds=re)
    for gait in GAITS
    for re in (REYNOLDS if gait == "carling" else ENDS)
]


def _select(runs: Runs, gait: str) -> dict[int, Result]:
    """Return the runs of a gait by Reynolds number."""
    return runs.by("reynolds", body_length=BODY_LENGTH, num_beats=NUM_BEATS, gait=gait)


def judge(runs: Runs) -> Iterator[Check]:
    """Check the exponent of speed against Reynolds number; record each gait."""
    speeds = {re: run["speed"][-1] for re, run in _select(runs, "carling").items()}
    yield Check(
        "exponent p of U L / ν ∝ Sw^p, Re = 500–7142",
        1.0 - fit_order(speeds),
        EXPONENT,
        SOURCE,
        tolerance=0.1,
        resolution=f"L = {BODY_LENGTH}",
        refinement={f"Re = {re}": speed for re, speed in speeds.items()},
        note="its values by run are speeds in L / T.",
    )
    for gait in GAITS:
        tail = GAITS[gait].tail_speed / pi  # peak to peak, L
        for reynolds, run in _select(runs, gait).items():
            speed, power = run["speed"][-1], run["power"][-1]
            note = (
                f"Power {power:.4f} ρL⁴/T³, cost of transport {power / speed:.4f} L/T², "
                f"Strouhal number of the tail 2a f / U = {tail / speed:.2f}."
            )
            name = f"speed, {gait}, Re = {reynolds}, L / T"
            yield Check(name, speed, resolution=f"L = {BODY_LENGTH}", note=note)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw speed against time for every gait, and against the Reynolds number."""
    left, right = figure.subplots(1, 2)
    for gait, colour in zip(GAITS, COLOURS, strict=False):
        for reynolds, style in zip(ENDS, ("--", "-"), strict=True):
            run = _select(runs, gait)[reynolds]
            draw_speed(left, run, style, color=colour, label=f"{gait}, Re = {reynolds}")
    left.set(ylabel="speed over each beat  U T / L", ylim=(0.0, 0.8))
    tail = GAITS["carling"].tail_speed
    found = _select(runs, "carling")
    sw = [tail * re for re in found]
    motion = [re * run["speed"][-1] for re, run in found.items()]
    right.loglog(sw, motion, "o-", label="Carling's gait")
    line = [motion[0] * (s / sw[0]) ** EXPONENT for s in sw]
    right.loglog(sw, line, "--", color=GREY, label="Sw^(4/3)")
    right.set(xlabel="swimming number  Sw", ylabel="Reynolds number of the motion  U L / ν")
    name_ticks(right, sw)


CASE = Case("gaits", __doc__, SOURCE, JOBS, judge, draw, size=(9.0, 4.0))
