"""Gait library.

The swimmer of the case above, L = 100, with every gait of the library at Re = L² / (T ν) = 500 (the
paper's Task 2) and 7142 (Tasks 0 and 1), Carling's at Reynolds numbers between. Speed over the
tenth beat; the tail's speed is 0.07 nodes per step in all. The cost of transport is the power of
the muscles over ρ L² U, in L / T²; the swimming number is Sw = 2π a(1) L² / (T ν), the Reynolds
number of the motion U L / ν.
"""

from collections.abc import Sequence
from math import pi

from matplotlib.figure import Figure

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Results, select
from experiments.validation.convergence import GREY, fit_order
from experiments.validation.swimming import make_swim
from fishrl.physics.bodies.gait import GAITS

BODY_LENGTH = 100
NUM_BEATS = 10
REYNOLDS = (500, 1000, 2000, 4000, 7142)
ENDS = (500, 7142)
QUICK_LENGTH, QUICK_BEATS = 50, 6
EXPONENT = 4.0 / 3.0
SOURCE = "Gazzola, Argentina & Mahadevan 2014, Nature Phys. 10, 758: Re ∝ Sw^(4/3), laminar"


def _label(gait: str, reynolds: int) -> str:
    return f"{gait}, Re = {reynolds}"


def make_jobs(quick: bool) -> list[Job]:
    """Return a swim for each gait and Reynolds number."""
    if quick:
        return [make_swim(_label("carling", 500), QUICK_LENGTH, QUICK_BEATS, reynolds=500)]
    return [
        make_swim(_label(gait, re), BODY_LENGTH, NUM_BEATS, gait=gait, reynolds=re)
        for gait in GAITS
        for re in (REYNOLDS if gait == "carling" else ENDS)
    ]


def _read_speeds(results: Results) -> dict[int, float]:
    runs = select(results, {re: _label("carling", re) for re in REYNOLDS})
    return {re: run["speed"][-1] for re, run in runs.items()}


def judge(results: Results) -> Sequence[Check]:
    """Judge the exponent of speed against Reynolds number; record each gait."""
    checks = []
    speeds = _read_speeds(results)
    length = BODY_LENGTH if len(speeds) > 1 else QUICK_LENGTH
    if len(speeds) > 1:
        checks.append(
            Check(
                quantity="exponent p of U L / ν ∝ Sw^p, Re = 500–7142",
                ours=1.0 - fit_order(speeds),
                reference=EXPONENT,
                source=SOURCE,
                tolerance=0.1,
                resolution=f"L = {length}",
                refinement={f"Re = {re}": speed for re, speed in speeds.items()},
                note="The refinement row holds the speeds in L / T.",
            )
        )
    for label, result in results.items():
        speed, power = result["speed"][-1], result["power"][-1]
        tail = GAITS[label.split(",")[0]].tail_speed / pi  # peak to peak, L
        checks.append(
            Check(
                quantity=f"speed, {label}, L / T",
                ours=speed,
                resolution=f"L = {length}",
                note=(
                    f"Power {power:.4f} ρL⁴/T³, cost of transport {power / speed:.4f} L/T², "
                    f"Strouhal number of the tail 2a f / U = {tail / speed:.2f}."
                ),
            )
        )
    return checks


def draw(results: Results) -> Figure:
    """Draw speed against time for every gait, and against the Reynolds number."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for gait, colour in zip(GAITS, COLOURS, strict=False):
        for reynolds, style in zip(ENDS, ("--", "-"), strict=True):
            if result := results.get(_label(gait, reynolds)):
                beats = [beat + 0.5 for beat in range(len(result["speed"]))]
                name = f"{gait}, Re = {reynolds}"
                left.plot(beats, result["speed"], style, color=colour, label=name)
    left.set(xlabel="time  t / T", ylabel="speed over each beat  U T / L", ylim=(0.0, 0.8))
    left.legend(fontsize=8, loc="upper left")
    speeds = _read_speeds(results)
    sw = [GAITS["carling"].tail_speed * re for re in speeds]
    motion = [re * speed for re, speed in speeds.items()]
    right.loglog(sw, motion, "o-", color=COLOURS[0], label="Carling's gait")
    line = [motion[0] * (s / sw[0]) ** EXPONENT for s in sw]
    right.loglog(sw, line, "--", color=GREY, label="Sw^(4/3)")
    right.set(xlabel="swimming number  Sw", ylabel="Reynolds number of the motion  U L / ν")
    right.set_xticks(sw, [f"{s:.0f}" for s in sw])
    right.minorticks_off()
    right.legend(fontsize=8)
    return figure


CASE = Case("gaits", __doc__, SOURCE, make_jobs, judge, draw)
