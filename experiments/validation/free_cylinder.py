"""Cylinder in an unbounded stream: drag, wake length, lift and shedding at Re 20 to 200."""

from collections.abc import Mapping, Sequence
from math import prod

import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation.case import Case, Check, Job, Result, Results
from experiments.validation.wake import (
    draw_vorticity,
    make_even,
    record_force,
    take_vorticity,
)
from fishrl.physics import (
    Cylinder,
    Fixed,
    FlowConfig,
    InPlaceSolver,
    compute_coefficient,
    compute_spectral_frequency,
    measure_cycles,
)
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge
from fishrl.physics.immersed_boundary import DirectSolve

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
VIEW_D = (-3, 15, -4, 4)  # left, right, low, high
STREAM = NonEquilibrium(velocity=(1.0, 0.0))


def run_cylinder(*, diameter: int, height: int, reynolds: int, speed: float) -> Result:
    """Run a cylinder in a box that lets sound out on all sides but the inflow.

    Args:
        diameter: D in nodes.
        height: of the box in D; the cylinder stands half of it behind the inflow.
        reynolds: U D / nu, a key of ``TRAVELS``.
        speed: U, nodes per step.

    Returns:
        Coefficients, Strouhal number or wake length, and the last of the series.
    """
    nu = speed * diameter / reynolds
    is_shedding = reynolds in SHEDDING
    kick = Fixed(kick_speed=0.3 * speed, kick_steps=round(3 * diameter / speed))
    upstream, downstream = height // 2, max(20, height // 2)
    config = FlowConfig(
        width=(upstream + downstream) * diameter + 1,
        height=height * diameter + 1,
        tau=3.0 * nu + 0.5,
        stream_speed=speed,
        bodies=(Cylinder(diameter=diameter, motion=kick if is_shedding else Fixed()),),
        boundaries=Boundaries(
            left=STREAM,
            right=OpenEdge(),
            bottom=OpenEdge(is_plane=False),
            top=OpenEdge(is_plane=False),
        ),
        force_solve=DirectSolve(regularisation=0.0),
    )
    solver = InPlaceSolver(config=config, num_envs=1, num_workers=0)
    x, y = upstream * diameter, height * diameter // 2
    place = torch.tensor([[x, y]]).double()
    solver.reset_(torch.ones(1, dtype=torch.bool), place, velocity=(1.0, 0.0))
    interval = make_even(diameter / speed / 30.0)
    record_force(solver, round(0.6 * TRAVELS[reynolds] * diameter / speed), interval)
    force = record_force(solver, round(0.4 * TRAVELS[reynolds] * diameter / speed), interval)
    rho, u = solver.macroscopic()
    density = float(rho[0, :, 1].double().mean())
    drag, lift = compute_coefficient(
        force, length=float(diameter), speed=speed, rho=density
    ).unbind(-1)
    reach = (
        x + VIEW_D[0] * diameter,
        x + VIEW_D[1] * diameter,
        y + VIEW_D[2] * diameter,
        y + VIEW_D[3] * diameter,
    )
    result: Result = {
        "inflow_density": density,
        "drag_series": [round(v, 5) for v in drag[-300:].tolist()],
        "lift_series": [round(v, 5) for v in lift[-300:].tolist()],
        "interval": interval * speed / diameter,
        "vorticity": take_vorticity(solver, reach, scale=diameter / speed),
    }
    if not is_shedding:
        late = drag[-len(drag) // 4 :]
        return result | {
            "drag": float(late.mean()),
            "drift": float(late[-1] - late[0]),
            "wake_length": _measure_wake(u[0, 0, y], x + 0.5 * diameter) / diameter,
        }
    beat = measure_cycles(lift, result["interval"])
    swing = measure_cycles(drag, result["interval"], clock=lift)
    return result | {
        "strouhal": beat.frequency,
        "spectral": compute_spectral_frequency(lift, result["interval"]),
        "drag": swing.mean,
        "drag_amplitude": swing.amplitude,
        "lift_amplitude": beat.amplitude,
        "lift_mean": beat.mean,
        "num_cycles": beat.num_cycles,
    }


def _measure_wake(u: Tensor, rear: float) -> float:
    """Return how far behind the rear stagnation point the flow along the axis stops returning."""
    values = u.double().tolist()
    start = round(rear) + 2
    at = next(i for i in range(start, len(values)) if values[i - 1] < 0.0 <= values[i])
    return at - values[at] / (values[at] - values[at - 1]) - rear


def _name(setup: tuple[int, int, float]) -> str:
    diameter, height, speed = setup
    return f"D = {diameter}, H = {height} D, U = {speed}"


NAMES = tuple(_name(setup) for setup in SETUPS)
NOTES: Mapping[tuple[int, str], str] = {
    (20, "wake_length"): (
        "the wake is 15 to 30 nodes long here and begins at a surface that markers 0.45 nodes "
        "inside place to about a tenth of a node, which is about what is missing; D = 32, a third "
        "height and half the speed were tried and left it there."
    ),
}


def extrapolate(values: Mapping[str, float]) -> float:
    """Return a quantity in a wide domain, on a fine grid, at no Mach number.

    Of height: a parabola in D / H through three heights at D = 16 (Qu et al. 2013 find their C_d
    linear in it). Of resolution and speed: 1 / D^2 at each speed first, then U^2; the error of the
    body's surface depends on both, as the relaxation time does.

    Args:
        values: by the names of ``NAMES``.
    """
    base, fine, slow, fine_slow, tall, taller = (values[name] for name in NAMES)
    heights = [(1.0 / setup[1]) for setup in (BASE, TALL, TALLER)]
    wide = 0.0
    for i, value in enumerate((base, tall, taller)):
        others = [h for j, h in enumerate(heights) if j != i]
        wide += value * prod((BLOCKAGE - h) / (heights[i] - h) for h in others)
    ratio = (FINE[0] / BASE[0]) ** 2 - 1.0
    fast, slow = fine + (fine - base) / ratio, fine_slow + (fine_slow - slow) / ratio
    exact = slow + (slow - fast) / ((BASE[2] / SLOW[2]) ** 2 - 1.0)
    return wide * exact / base


def _label(reynolds: int, setup: tuple[int, int, float]) -> str:
    return f"Re = {reynolds}, {_name(setup)}"


class FreeCylinder(Case):
    """Cylinder without walls at Re 20, 40, 100 and 200."""

    name = "free-cylinder"
    title = "Cylinder in an unbounded stream"
    source = "what others found, as third parties quote them: the range of each number"
    setup = (
        "Box of height H, 20 D to 60 D; the cylinder stands H / 2 behind an inflow of uniform "
        "velocity U, and the outflow 20 D or more behind it. Sides and outflow let sound out. "
        "Markers lie 0.45 nodes inside the outline, no slip is solved exactly. 50 to 140 D / U, of "
        "which the last 40 % are measured, over whole periods. Judged is the value on a fine grid, "
        "at no Mach number and at D / H = 1 / 100, the blockage of the references' own domains: "
        "by two larger heights at D = 16, and by D = 16 and 32 at both U and U / 2. "
        "The wake length L_w runs from the rear stagnation point to where the flow on the axis "
        "stops returning."
    )

    def jobs(self, *, quick: bool) -> Sequence[Job]:
        """Return a run per Reynolds number, and what resolution, height and speed change."""
        runs = [(re, setup) for re in TRAVELS for setup in SETUPS]
        if quick:
            runs = [(re, BASE) for re in (40, 100)]
        return [
            Job(
                label=_label(re, setup),
                function=run_cylinder,
                arguments={
                    "diameter": setup[0],
                    "height": setup[1],
                    "reynolds": re,
                    "speed": setup[2],
                },
                cost=1.5 * setup[1] ** 2 * TRAVELS[re] * setup[0] ** 3 / setup[2],
            )
            for re, setup in runs
        ]

    def judge(self, results: Results) -> Sequence[Check]:
        """Judge what is left without walls; a quick run shows its numbers without judging."""
        checks = []
        for reynolds, key, name, reference, source in REFERENCES:
            labels = {_name(setup): _label(reynolds, setup) for setup in SETUPS}
            values = {n: results[at][key] for n, at in labels.items() if at in results}
            if not values:
                continue
            is_whole = len(values) == len(SETUPS)
            whole = extrapolate(values) if is_whole else values[_name(BASE)]
            checks.append(
                Check(
                    quantity=f"{name}, Re = {reynolds}" + ("" if is_whole else ", with walls"),
                    ours=whole,
                    reference=reference if is_whole else None,
                    source=source,
                    resolution="extrapolated" if is_whole else _name(BASE),
                    refinement=values | ({"extrapolated": whole} if is_whole else {}),
                    note=NOTES.get((reynolds, key), "") if is_whole else "",
                )
            )
        return checks

    def draw(self, results: Results) -> Figure:
        """Draw the wakes."""
        setup = TALL
        runs = {re: r for re in TRAVELS if (r := results.get(_label(re, TALL)))}
        if not runs:
            setup, runs = BASE, {re: r for re in TRAVELS if (r := results.get(_label(re, BASE)))}
        figure = Figure(figsize=(9.6, 4.6), layout="constrained")
        for axes, (reynolds, run) in zip(figure.subplots(2, 2).flat, runs.items(), strict=False):
            draw_vorticity(axes, run["vorticity"], VIEW_D, limit=3.0)
            axes.set_title(f"Re = {reynolds}, D = {setup[0]} nodes, H = {setup[1]} D", loc="left")
        for axes in figure.axes[len(runs) : 4] if len(runs) < 4 else ():
            axes.set_visible(False)
        return figure
