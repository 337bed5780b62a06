"""Lid-driven cavity.

Square box of N × N node distances whose top slides at U = 0.1, Re = U N / ν. Judged with half-way
bounce-back walls; beside it, for the record, the same cavity with non-equilibrium extrapolation on
all four edges, lid at full speed up to its corners. The fast step in single precision runs until no
velocity changes by more than 10⁻⁵ U while the lid travels the width. Extremes along the centre
lines are those of parabolas through three nodes; flow is the sum of u over the vertical centre
line, which should be nothing. The references are Chebyshev solutions of incompressible flow; what
is left of the error at Re = 100 is compressibility, and falls as U².
"""

from collections.abc import Sequence

from matplotlib.figure import Figure

from experiments.figures import COLOURS
from experiments.validation import ghia
from experiments.validation.case import Case, Check, Job, Result, Results, check_finest, select
from experiments.validation.convergence import GREY, find_extreme
from fishrl.physics import Boundaries, FlowConfig, InPlaceSolver, NonEquilibrium, NoSlip

LID_SPEED = 0.1
SIZES = (64, 128, 256)
QUICK_SIZES = (64, 128)
STEADY = 1e-5  # largest change of velocity / lid speed while the lid travels the cavity's width
MAX_TRAVELS = 200
TOLERANCE = 0.01
# Botella & Peyret, Comput. Fluids 27 (1998) 421, as others quote it; Marchi, Suero & Araki,
# J. Braz. Soc. Mech. Sci. Eng. 31 (2009) 186, from 1024 x 1024 nodes, agree to 2e-5.
SPECTRAL = {
    100: {"u_min": -0.2140424, "v_max": 0.1795728, "v_min": -0.2538030},
    1000: {"u_min": -0.3885698, "v_max": 0.3769447, "v_min": -0.5270771},
}
SOURCE = "Botella & Peyret 1998, spectral"
WALLS = {True: "bounce-back", False: "extrapolation"}  # by whether they are half-way
# what the figure shows: size, whether bounce-back, line
LINES = ((256, True, "-"), (256, False, "--"), (64, True, ":"))
LEAK = (
    "with edges by extrapolation the error of the extremes falls no faster than 1 / N and grows "
    "with the lid speed: they conserve no mass, and beside a sliding wall that flow is lost."
)


def drive_cavity(*, size: int, reynolds: float, is_half_way: bool) -> Result:
    """Drive a cavity, N = ``size`` node distances wide, until it is steady.

    Half-way bounce-back has N nodes, non-equilibrium extrapolation N + 1. Returns positions and
    velocities / U along the centre lines, walls included, their extremes, and the ``flow`` through
    the vertical one (none in an incompressible fluid) / (U x node distance).
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
    u_line = (u[0, 0, :, middle].double().mean(-1) / LID_SPEED).tolist()
    v_line = (u[0, 1, middle, :].double().mean(0) / LID_SPEED).tolist()
    offset = 0.5 if is_half_way else 0.0
    return {
        "position": [(i + offset) / size for i in range(num_nodes)],
        "u": u_line,
        "v": v_line,
        "u_min": find_extreme(u_line, sign=-1),
        "v_max": find_extreme(v_line, sign=1),
        "v_min": find_extreme(v_line, sign=-1),
        "flow": sum(u_line) - (0.0 if is_half_way else 0.5 * u_line[-1]),
    }


def _label(size: int, reynolds: int, is_half_way: bool) -> str:
    return f"Re = {reynolds}, {WALLS[is_half_way]}, N = {size}"


def make_jobs(quick: bool) -> list[Job]:
    """Return a run for each Reynolds number, kind of wall and size."""
    return [
        Job(
            _label(size, reynolds, is_half_way),
            drive_cavity,
            {"size": size, "reynolds": reynolds, "is_half_way": is_half_way},
            cost=(20 if reynolds == 100 else 80) * size**3 / LID_SPEED,
        )
        for reynolds in SPECTRAL
        for is_half_way in ((True,) if quick else WALLS)
        for size in (QUICK_SIZES if quick else SIZES)
    ]


def judge(results: Results) -> Sequence[Check]:
    """Judge the extremes along the centre lines."""
    checks = []
    for is_half_way, walls in WALLS.items():
        for reynolds, references in SPECTRAL.items():
            runs = select(results, {n: _label(n, reynolds, is_half_way) for n in SIZES})
            if not runs:
                continue
            where = f"Re = {reynolds}, {walls}"
            tolerance, note = (TOLERANCE, "") if is_half_way else (None, LEAK)
            for key, reference in references.items():
                values = {n: run[key] for n, run in runs.items()}
                checks.append(
                    check_finest(
                        f"{key} / U, {where}", values, reference, SOURCE, tolerance, symbol="N"
                    )
                )
            checks.append(
                check_finest(
                    f"flow / (U × node distance), {where}",
                    {n: run["flow"] for n, run in runs.items()},
                    reference=0.0,
                    source="mass",
                    is_absolute=True,
                    symbol="N",
                    note=note,
                )
            )
    return checks


def draw(results: Results) -> Figure:
    """Draw both centre lines at each Reynolds number."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2)
    for row, reynolds in zip(panels, SPECTRAL, strict=True):
        tables = (
            ("u", ghia.Y, ghia.U[reynolds], "y / L", "u / U on the vertical centre line"),
            ("v", ghia.X, ghia.V[reynolds], "x / L", "v / U on the horizontal centre line"),
        )
        for axes, (key, places, values, along, title) in zip(row, tables, strict=True):
            for (size, is_half_way, style), colour in zip(LINES, COLOURS, strict=False):
                if line := results.get(_label(size, reynolds, is_half_way)):
                    name = f"{WALLS[is_half_way]}, N = {size}"
                    axes.plot(line["position"], line[key], style, color=colour, label=name)
            axes.plot(
                places, values, "o", color="black", markerfacecolor="none", markersize=5,
                label="Ghia et al. 1982",
            )  # fmt: skip
            for name, value in SPECTRAL[reynolds].items():
                if name.startswith(key):
                    axes.axhline(value, color=GREY, linewidth=0.8, zorder=0)
            axes.set(xlabel=along, ylabel=f"{key} / U", title=f"{title}, Re = {reynolds}")
    panels[0, 0].legend(title="grey: spectral extremes", fontsize=9, title_fontsize=9)
    return figure


SOURCES = (
    "Botella & Peyret 1998 (Marchi, Suero & Araki 2009 agree to four digits); circles in the "
    "figure: Ghia, Ghia & Shin 1982, on 129 × 129 points"
)
CASE = Case("cavity", __doc__, SOURCES, make_jobs, judge, draw)
