"""Lid-driven cavity.

The lid of a square cavity of N × N node distances slides at U = 0.1; Re = U N / ν. The acceptance
criteria apply to half-way bounce-back walls. For comparison, the same cavity is run with
non-equilibrium extrapolation on all four edges, where the lid has full speed up to its corners. The
fast step runs in single precision until no velocity changes by more than 10⁻⁵ U while the lid
travels one cavity width. Extrema along the centre lines are those of parabolas through three nodes;
"flow" is the sum of u over the vertical centre line, which is zero if mass is conserved. The
references are Chebyshev solutions of incompressible flow. The remaining error at Re = 100 is due to
compressibility and decreases as U².
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import GREY, draw_reference
from fishrl.physics import Boundaries, FlowConfig, InPlaceSolver, NonEquilibrium, NoSlip
from fishrl.physics.diagnostics import find_peak

LID_SPEED = 0.1
SIZES = (64, 128, 256)
STEADY = 1e-5  # largest change of velocity / lid speed while the lid travels the cavity's width
MAX_TRAVELS = 200
TOLERANCE = 0.01
# Botella & Peyret, Comput. Fluids 27 (1998) 421, as others quote it; Marchi, Suero & Araki,
# J. Braz. Soc. Mech. Sci. Eng. 31 (2009) 186, from 1024 x 1024 nodes, agree to 2e-5.
SPECTRAL = {
    100: {"u_min": -0.2140424, "v_max": 0.1795728, "v_min": -0.2538030},
    1000: {"u_min": -0.3885698, "v_max": 0.3769447, "v_min": -0.5270771},
}
# Ghia, Ghia & Shin, J. Comput. Phys. 48 (1982) 387, tables I and II, from 129 x 129 points
GHIA = np.loadtxt(Path(__file__).with_name("ghia_1982.csv"), delimiter=",", skiprows=1).T
WALLS = {True: "bounce-back", False: "extrapolation"}  # by whether they are half-way
# what the figure shows: size, whether bounce-back, line
LINES = ((256, True, "-"), (256, False, "--"), (64, True, ":"))
LEAK = (
    "with extrapolation at the edges, the error of the extrema decreases no faster than 1 / N "
    "and grows with the lid speed, because these edges do not conserve mass."
)


def drive_cavity(*, size: int, reynolds: float, is_half_way: bool) -> Result:
    """Drive a cavity, ``size`` node distances wide, until it is steady.

    Returns velocities / U along the centre lines, their extremes, and the ``flow`` through the
    vertical one / (U x node distance).
    """
    lid = (LID_SPEED, 0.0)
    walls = NoSlip() if is_half_way else NonEquilibrium(velocity=(0.0, 0.0))
    top = NoSlip(velocity=lid) if is_half_way else NonEquilibrium(velocity=lid)
    num_nodes = size if is_half_way else size + 1
    config = FlowConfig(
        width=num_nodes,
        height=num_nodes,
        tau=3.0 * LID_SPEED * size / reynolds + 0.5,
        boundaries=Boundaries(left=walls, right=walls, bottom=walls, top=top),
    )
    solver = InPlaceSolver(config=config, num_envs=1, num_workers=0)
    travel = 2 * round(size / LID_SPEED / 2)
    u, travels, change = solver.macroscopic()[1], 0, 1.0
    while change > STEADY * LID_SPEED:
        if travels == MAX_TRAVELS:
            raise RuntimeError(f"the cavity is not steady after {travels} lid travels: {change}")
        before = u
        solver.advance_(travel)
        u = solver.macroscopic()[1]
        travels, change = travels + 1, float((u - before).abs().max())
    middle = [size // 2 - 1, size // 2] if is_half_way else [size // 2]
    u_line = u[0, 0, :, middle].double().mean(-1) / LID_SPEED
    v_line = u[0, 1, middle, :].double().mean(0) / LID_SPEED
    offset = 0.5 if is_half_way else 0.0
    return {
        "position": [(i + offset) / size for i in range(num_nodes)],
        "u": u_line.tolist(),
        "v": v_line.tolist(),
        "u_min": -find_peak(-u_line),
        "v_max": find_peak(v_line),
        "v_min": -find_peak(-v_line),
        "flow": sum(u_line.tolist()) - (0.0 if is_half_way else 0.5 * float(u_line[-1])),
    }


JOBS = [
    Job(
        drive_cavity,
        {"size": size, "reynolds": reynolds, "is_half_way": is_half_way},
        cost=(20 if reynolds == 100 else 80) * size**3 / LID_SPEED,
        is_quick=is_half_way and size == 128,
    )
    for reynolds in SPECTRAL
    for is_half_way in WALLS
    for size in SIZES
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check the extremes along the centre lines."""
    for is_half_way, walls in WALLS.items():
        tolerance, note = (TOLERANCE, "") if is_half_way else (None, LEAK)
        for reynolds, references in SPECTRAL.items():
            flow = runs.read("flow", "size", reynolds=reynolds, is_half_way=is_half_way)
            if not flow:
                continue
            where = f"Re = {reynolds}, {walls}"
            for key, reference in references.items():
                values = runs.read(key, "size", reynolds=reynolds, is_half_way=is_half_way)
                criterion = (reference, "Botella & Peyret 1998, spectral", tolerance)
                yield check_refined("N", f"{key} / U, {where}", values, *criterion)
            name = f"flow / (U × node distance), {where}"
            yield check_refined("N", name, flow, 0.0, "mass", is_absolute=True, note=note)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw both centre lines at each Reynolds number."""
    panels = figure.subplots(2, 2)
    for row, reynolds in zip(panels, SPECTRAL, strict=True):
        for axes, key, along, line, (places, *columns) in (
            (row[0], "u", "y / L", "vertical", GHIA[:3]),
            (row[1], "v", "x / L", "horizontal", GHIA[3:]),
        ):
            for size, is_half_way, style in LINES:
                given = {"reynolds": reynolds, "is_half_way": is_half_way}
                if run := runs.by("size", **given).get(size):
                    name = f"{WALLS[is_half_way]}, N = {size}"
                    axes.plot(run["position"], run[key], style, label=name)
            values = columns[list(SPECTRAL).index(reynolds)]
            draw_reference(axes, zip(places, values, strict=True), "Ghia et al. 1982")
            for name, value in SPECTRAL[reynolds].items():
                if name.startswith(key):
                    axes.axhline(value, color=GREY, linewidth=0.8, zorder=0)
            axes.set(xlabel=along, ylabel=f"{key} / U")
            axes.set_title(f"{key} / U on the {line} centre line, Re = {reynolds}")
    panels[0, 0].legend(title="grey: spectral extremes")


SOURCE = (
    "Botella & Peyret 1998 (Marchi, Suero & Araki 2009 agree to four digits); circles in the "
    "figure: Ghia, Ghia & Shin 1982, on 129 × 129 points"
)
CASE = Case("cavity", __doc__, SOURCE, JOBS, judge, draw, size=(9.0, 7.0))
