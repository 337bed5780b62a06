"""Half disc in a stream: the flows in which the paper's fish holds its station."""

from collections.abc import Mapping, Sequence
from math import pi

import torch
from matplotlib.figure import Figure

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Result, Results
from experiments.validation.convergence import tidy
from experiments.validation.wake import (
    draw_vorticity,
    make_even,
    record_force,
    take_vorticity,
)
from fishrl.physics import (
    DCylinder,
    Fixed,
    FlowConfig,
    InPlaceSolver,
    compute_coefficient,
    compute_spectral_frequency,
    measure_cycles,
)
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, NoSlip, OpenEdge
from fishrl.physics.immersed_boundary import DirectSolve

WIDTH_D, HEIGHT_D, FACE_D = 25.0, 12.5, 6.25  # 1000 x 500 nodes, face at x = 250, with D = 40
SPEEDS = {200: 0.1, 250: 0.125, 300: 0.15}  # conditions I, II, III
PAPER = {200: 0.267, 250: 0.256, 300: 0.267}
SIZES = (20, 40)
TRAVELS = 120.0
STREAM = NonEquilibrium(velocity=(1.0, 0.0))
SIDES = {"moving sides": STREAM, "open sides": OpenEdge(is_plane=False), "walls": NoSlip()}
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
    """Run a half disc in the paper's domain until its wake repeats itself.

    Args:
        diameter: D in nodes; 40 is the paper's.
        reynolds: U D / nu, a key of ``SPEEDS``.
        sides: key of ``SIDES``, bottom and top.
        is_flat_downstream: the flat side's place; else it meets the flow.
        slowing: how many times slower than the paper's stream, in nodes per step.
        is_pinned: an outlet with pinned density instead of one that lets sound out.

    Returns:
        Strouhal number by zero crossings and by spectrum, force coefficients, the last series.
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
    solver = InPlaceSolver(config=config, num_envs=1, num_workers=0)
    centre = -1.0 if is_flat_downstream else 1.0  # 2 D / (3 pi) from the flat side
    x = FACE_D * diameter + centre * 2.0 * diameter / (3.0 * pi)
    y = 0.5 * (config.height - 1)
    heading = torch.tensor([pi if is_flat_downstream else 0.0])
    place = torch.tensor([[x, y]]).double()
    solver.reset_(torch.ones(1, dtype=torch.bool), place, heading, velocity=(1.0, 0.0))
    interval = make_even(diameter / speed / 30.0)
    num_steps = round(0.5 * TRAVELS * diameter / speed)
    record_force(solver, num_steps, interval)
    force = record_force(solver, num_steps, interval)
    rho, _ = solver.macroscopic()
    density = float(rho[0, :, 1].double().mean())
    drag, lift = compute_coefficient(
        force, length=float(diameter), speed=speed, rho=density
    ).unbind(-1)
    unit = interval * speed / diameter
    beat, swing = measure_cycles(lift, unit), measure_cycles(drag, unit, clock=lift)
    window = (
        round(4 * diameter),
        round(22 * diameter),
        round(2 * diameter),
        round(10.5 * diameter),
    )
    return {
        "strouhal": beat.frequency,
        "spectral": compute_spectral_frequency(lift, unit),
        "num_cycles": beat.num_cycles,
        "drag": swing.mean,
        "drag_amplitude": swing.amplitude,
        "lift_amplitude": beat.amplitude,
        "lift_mean": beat.mean,
        "inflow_density": density,
        "interval": unit,
        "lift_series": [round(v, 4) for v in lift[-300:].tolist()],
        "vorticity": take_vorticity(solver, window, scale=diameter / speed),
    }


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
VIEW_D = (4 - FACE_D, 22 - FACE_D, 2 - 0.5 * HEIGHT_D, 10.5 - 0.5 * HEIGHT_D)


def _label(reynolds: int, size: int, variant: str) -> str:
    return f"Re = {reynolds}, D = {size}" + (f", {variant}" if variant else "")


class HalfDisc(Case):
    """Half disc at Re 200, 250 and 300 in the paper's domain."""

    name = "d-cylinder"
    title = "Half disc: the three flows of the Kármán gait"
    source = "recorded; beside it the shedding frequencies in the paper's table"
    setup = (
        "The paper's domain, 25 D × 12.5 D (1000 × 500 nodes with D = 40; blockage 8 %), the flat "
        "side of the half disc 6.25 D behind the inflow; streams of 0.1, 0.125 and 0.15 nodes per "
        "step make Re = 200, 250 and 300 (conditions I, II, III). Flat side downstream, inflow and "
        "sides move with the stream, the outflow lets plane sound waves out; markers 0.45 "
        "nodes inside the outline, no slip solved directly. A kick, then 120 D / U, of which the "
        "second half is measured over whole periods. St = f D / U of the lift, by its zero "
        "crossings and by its spectrum. At D = 20 beside it: sides that let sound out as well, "
        "no-slip walls, half the speed at the same Re, the flat side upstream, and a pinned "
        "density at the outflow."
    )

    def jobs(self, *, quick: bool) -> Sequence[Job]:
        """Return a run per condition, size and variant."""
        runs = [(re, 20, variant) for re in SPEEDS for variant in ("", *VARIANTS)]
        runs += [(re, 40, "") for re in SPEEDS]
        if quick:
            runs = [(200, 20, "")]
        return [
            Job(
                label=_label(re, size, variant),
                function=run_half_disc,
                arguments={"diameter": size, "reynolds": re} | VARIANTS.get(variant, {}),
                cost=WIDTH_D * HEIGHT_D * TRAVELS * size**3 / SPEEDS[re],
            )
            for re, size, variant in runs
        ]

    def judge(self, results: Results) -> Sequence[Check]:
        """Show what was measured beside the paper; nothing is judged."""
        checks = []
        for reynolds in SPEEDS:
            known = {n: r for n in SIZES if (r := results.get(_label(reynolds, n, "")))}
            if not known:
                continue
            named = {
                "D = 20": (20, ""),
                "D = 40": (40, ""),
            } | {f"D = 20, {variant}": (20, variant) for variant in VARIANTS}
            for key, name in QUANTITIES.items():
                finest = max(known)
                checks.append(
                    Check(
                        quantity=f"{name}, Re = {reynolds}",
                        ours=known[finest][key],
                        reference=PAPER[reynolds] if key == "strouhal" else None,
                        source="the paper's table" if key == "strouhal" else "",
                        resolution=f"D = {finest}",
                        refinement={
                            label: r[key]
                            for label, run in named.items()
                            if (r := results.get(_label(reynolds, *run)))
                        },
                        note=NOTE if key == "strouhal" else "",
                    )
                )
        return checks

    def draw(self, results: Results) -> Figure:
        """Draw the wakes and the lift."""
        figure = Figure(figsize=(7.6, 8.2), layout="constrained")
        known = {
            re: (n, r) for re in SPEEDS for n in SIZES if (r := results.get(_label(re, n, "")))
        }
        grid = figure.subplots(len(known) + 1, 1)
        for axes, (reynolds, (size, run)) in zip(grid, known.items(), strict=False):
            draw_vorticity(axes, run["vorticity"], VIEW_D, limit=5.0)
            axes.set_title(f"Re = {reynolds}, D = {size} nodes", loc="left")
        for colour, (reynolds, (_, run)) in zip(COLOURS, known.items(), strict=False):
            time = [i * run["interval"] for i in range(len(run["lift_series"]))]
            grid[-1].plot(time, run["lift_series"], color=colour, label=f"Re = {reynolds}")
        grid[-1].set(xlabel="time  [D / U]", ylabel="lift coefficient")
        grid[-1].legend(fontsize=9, ncols=3, loc="upper right")
        tidy(grid[-1])
        return figure
