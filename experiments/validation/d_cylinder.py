"""Half disc: the three flows of the Kármán gait.

The paper's domain, 25 D × 12.5 D (1000 × 500 nodes with D = 40; blockage 8 %), the flat side of the
half disc 6.25 D behind the inflow; streams of 0.1, 0.125 and 0.15 nodes per step make Re = 200, 250
and 300 (conditions I, II, III). Flat side downstream, inflow and sides move with the stream, the
outflow lets plane sound waves out; markers 0.45 nodes inside the outline, no slip solved directly.
A kick, then 120 D / U, of which the second half is measured over whole periods. St = f D / U of the
lift, by its zero crossings and by its spectrum. At D = 20 beside it: sides that let sound out as
well, no-slip walls, half the speed at the same Re, the flat side upstream, and a pinned density at
the outflow.
"""

from collections.abc import Mapping, Sequence
from math import pi

from matplotlib.figure import Figure

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Result, Results, select
from experiments.validation.wake import draw_vorticity, make_even, measure_wake, start_flow
from fishrl.physics import DCylinder, Fixed, FlowConfig
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, NoSlip, OpenEdge
from fishrl.physics.immersed_boundary import DirectSolve

WIDTH_D, HEIGHT_D, FACE_D = 25.0, 12.5, 6.25  # 1000 x 500 nodes, face at x = 250, with D = 40
WINDOW_D = (4.0, 22.0, 2.0, 10.5)  # of the picture: left, right, low, high
SPEEDS = {200: 0.1, 250: 0.125, 300: 0.15}  # conditions I, II, III
PAPER = {200: 0.267, 250: 0.256, 300: 0.267}
SIZES = (20, 40)
TRAVELS = 120.0
STREAM = NonEquilibrium(velocity=(1.0, 0.0))
SIDES = {"moving sides": STREAM, "open sides": OpenEdge(is_plane=False), "walls": NoSlip()}
# beside the plain run of every condition and size
VARIANTS: Mapping[str, dict[str, str | bool | float]] = {
    "open sides": {"sides": "open sides"},
    "walls": {"sides": "walls"},
    "half the speed": {"slowing": 2.0},
    "half the speed, open sides": {"slowing": 2.0, "sides": "open sides"},
    "flat side upstream": {"is_flat_downstream": False},
    "pinned outlet": {"is_pinned": True},
}
QUANTITIES = {
    "strouhal": "St by zero crossings",
    "spectral": "St by spectrum",
    "drag": "C_d",
    "lift_amplitude": "C_l amplitude",
}
NOTE = (
    "The paper's shedding frequencies are exactly 1/1500, 1/1250 and 1/1000 per step: bins 10, 12 "
    "and 15 of a spectrum of 15000 steps would give them, 7 to 10 % apart, and they are not "
    "monotone in Re as Strouhal numbers; it does not say how they were found or which way the "
    "half disc faces. No other measured value at these Re was found."
)


def run_half_disc(
    *,
    diameter: int,
    reynolds: int,
    sides: str = "moving sides",
    is_flat_downstream: bool = True,
    slowing: float = 1.0,
    is_pinned: bool = False,
) -> Result:
    """Run a half disc in the paper's domain until its wake repeats itself; see ``measure_wake``.

    Args:
        diameter: D in nodes; 40 is the paper's.
        reynolds: U D / nu, a key of ``SPEEDS``.
        sides: key of ``SIDES``, bottom and top.
        is_flat_downstream: the flat side's place; else it meets the flow.
        slowing: how many times slower than the paper's stream, in nodes per step.
        is_pinned: an outlet with pinned density instead of one that lets sound out.
    """
    speed = SPEEDS[reynolds] / slowing
    nu = speed * diameter / reynolds
    kick = Fixed(kick_speed=0.3 * speed, kick_steps=round(3 * diameter / speed))
    config = FlowConfig(
        width=round(WIDTH_D * diameter),
        height=round(HEIGHT_D * diameter),
        tau=3.0 * nu + 0.5,
        stream_speed=speed,
        bodies=(DCylinder(diameter=diameter, motion=kick),),
        boundaries=Boundaries(
            left=STREAM,
            right=NonEquilibrium(density=1.0) if is_pinned else OpenEdge(),
            bottom=SIDES[sides],
            top=SIDES[sides],
        ),
        force_solve=DirectSolve(),
    )
    centre = -1.0 if is_flat_downstream else 1.0  # 2 D / (3 pi) from the flat side
    x = FACE_D * diameter + centre * 2.0 * diameter / (3.0 * pi)
    place = (x, 0.5 * (config.height - 1))
    solver = start_flow(config, place, pi if is_flat_downstream else 0.0, stream=(1.0, 0.0))
    num_steps = 0.5 * TRAVELS * diameter / speed
    return measure_wake(
        solver,
        diameter=diameter,
        speed=speed,
        num_steps=(num_steps, num_steps),
        interval=make_even(diameter / speed / 30.0),
        window=[side * diameter for side in WINDOW_D],
        is_shedding=True,
    )


def _label(reynolds: int, size: int, variant: str = "") -> str:
    return f"Re = {reynolds}, D = {size}" + (f", {variant}" if variant else "")


def make_jobs(quick: bool) -> list[Job]:
    """Return a run per condition, size and variant."""
    runs = [(re, 20, variant) for re in SPEEDS for variant in ("", *VARIANTS)]
    runs += [(re, 40, "") for re in SPEEDS]
    return [
        Job(
            _label(re, size, variant),
            run_half_disc,
            {"diameter": size, "reynolds": re} | VARIANTS.get(variant, {}),
            cost=WIDTH_D * HEIGHT_D * TRAVELS * size**3 / SPEEDS[re],
        )
        for re, size, variant in ([(200, 20, "")] if quick else runs)
    ]


def judge(results: Results) -> Sequence[Check]:
    """Show what was measured beside the paper; nothing is judged."""
    checks = []
    for reynolds in SPEEDS:
        labels = {f"D = {size}": _label(reynolds, size) for size in SIZES}
        known = select(results, labels)
        labels |= {f"D = 20, {v}": _label(reynolds, 20, v) for v in VARIANTS}
        for key, name in QUANTITIES.items() if known else ():
            finest, is_beside_paper = list(known)[-1], key == "strouhal"
            checks.append(
                Check(
                    quantity=f"{name}, Re = {reynolds}",
                    ours=known[finest][key],
                    reference=PAPER[reynolds] if is_beside_paper else None,
                    source="the paper's table" if is_beside_paper else "",
                    resolution=finest,
                    refinement={n: run[key] for n, run in select(results, labels).items()},
                    note=NOTE if is_beside_paper else "",
                )
            )
    return checks


def draw(results: Results) -> Figure:
    """Draw the wakes and the lift."""
    figure = Figure(figsize=(7.6, 8.2), layout="constrained")
    finest: dict[int, tuple[int, Result]] = {}
    for reynolds in SPEEDS:
        if runs := select(results, {n: _label(reynolds, n) for n in SIZES}):
            finest[reynolds] = max(runs), runs[max(runs)]
    *wakes, lift = figure.subplots(len(finest) + 1, 1)
    left, right, low, high = WINDOW_D
    reach = (left - FACE_D, right - FACE_D, low - 0.5 * HEIGHT_D, high - 0.5 * HEIGHT_D)
    for axes, colour, (reynolds, (size, run)) in zip(wakes, COLOURS, finest.items(), strict=False):
        draw_vorticity(axes, run["vorticity"], reach, limit=5.0)
        axes.set_title(f"Re = {reynolds}, D = {size} nodes", loc="left")
        time = [i * run["interval"] for i in range(len(run["lift_series"]))]
        lift.plot(time, run["lift_series"], color=colour, label=f"Re = {reynolds}")
    lift.set(xlabel="time  [D / U]", ylabel="lift coefficient")
    lift.legend(fontsize=9, ncols=3, loc="upper right")
    return figure


SOURCE = "recorded; beside it the shedding frequencies in the paper's table"
CASE = Case("d-cylinder", __doc__, SOURCE, make_jobs, judge, draw)
