"""Compressibility.

The swimmer (L = 70 to 140, Re = 7142, free) with its tail, and a cylinder (D = 20, Re = 100, domain
20 D × 10 D, open to sound on all sides but the inflow) with its stream, at 0.14, 0.07 (the default
budget, Mach 0.12) and 0.035 nodes per step. Reynolds number and grid are fixed, so viscosity and
the length of a step follow. Swimming speed over beat 8; drag over 40 D of travel, lift as root mean
square.
"""

from collections.abc import Sequence

import torch
from matplotlib.figure import Figure

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Result, Results
from experiments.validation.swimming import make_swim
from experiments.validation.wake import start_flow
from fishrl.physics import Boundaries, Cylinder, Fixed, FlowConfig, NonEquilibrium, OpenEdge
from fishrl.physics.immersed_boundary import DirectSolve
from fishrl.physics.units import DEFAULT_WALL_SPEED

BODY_LENGTHS = (70, 100, 140)
JUDGED_LENGTH = 100
NUM_BEATS = 8
FACTORS = (2.0, 1.0, 0.5)  # of the default wall speed
DIAMETER = 20
REYNOLDS = 100.0
TRAVELS = 120  # diameters that the stream travels; the last third is measured
TOLERANCE = 0.02
# Name, flow, and what is read of it.
SERIES = (
    *((f"swimming speed, L = {n}", f"swimmer, L = {n}", "speed") for n in BODY_LENGTHS),
    ("mean drag of the cylinder", "cylinder", "drag"),
    ("lift of the cylinder", "cylinder", "lift"),
)
SWIMMER_NOTE = (
    " It falls with the resolution, so it is the body's resolution that depends on the time step "
    "here; at L = 50 tau leaves no room to halve the speed."
)


def hold_cylinder(*, speed: float) -> Result:
    """Hold a cylinder in a stream of ``speed`` nodes per step until its wake is periodic.

    Returns the mean drag coefficient and the root mean square of the lift coefficient.
    """
    stream, side = NonEquilibrium(velocity=(1.0, 0.0)), OpenEdge(is_plane=False)
    travel = round(DIAMETER / speed)
    kick = Fixed(kick_speed=0.2 * speed, kick_steps=4 * travel)
    config = FlowConfig(
        width=20 * DIAMETER,
        height=10 * DIAMETER,
        tau=3.0 * speed * DIAMETER / REYNOLDS + 0.5,
        stream_speed=speed,
        bodies=(Cylinder(diameter=DIAMETER, motion=kick),),
        # let sound out: between pinned edges it rings, and more so the faster the stream
        boundaries=Boundaries(left=stream, right=OpenEdge(), bottom=side, top=side),
        force_solve=DirectSolve(regularisation=0.0),
    )
    solver = start_flow(config, (6.0 * DIAMETER, 5.0 * DIAMETER), stream=(1.0, 0.0))
    samples_per_travel = 20
    gap = max(2, 2 * (travel // (2 * samples_per_travel)))
    solver.advance_(2 * (TRAVELS * travel // 3))
    start, forces = solver.body.impulse[0].clone(), []
    num_samples = TRAVELS * travel // 3 // gap
    for _ in range(num_samples):
        solver.advance_(gap)
        forces.append(solver.body.hydro_force[0].clone())
    mean = (solver.body.impulse[0] - start) / (num_samples * gap)
    lift = torch.stack(forces)[:, 1]
    unit = 0.5 * speed**2 * DIAMETER
    return {"drag": float(mean[0]) / unit, "lift": float((lift - lift.mean()).std()) / unit}


def _label(flow: str, factor: float) -> str:
    return f"{flow}, {factor * DEFAULT_WALL_SPEED:g} nodes per step"


def make_jobs(quick: bool) -> list[Job]:
    """Return both flows at three speeds; none is quick."""
    jobs = []
    for factor in () if quick else FACTORS:
        speed = factor * DEFAULT_WALL_SPEED
        jobs += [
            make_swim(_label(f"swimmer, L = {n}", factor), n, NUM_BEATS, max_wall_speed=speed)
            for n in BODY_LENGTHS
        ]
        cost = 200.0 * DIAMETER**3 * TRAVELS / speed
        jobs.append(Job(_label("cylinder", factor), hold_cylinder, {"speed": speed}, cost))
    return jobs


def _read(results: Results, flow: str, key: str) -> dict[float, float]:
    values = {f: results[_label(flow, f)][key] for f in FACTORS}
    return {f: v[-1] if isinstance(v, list) else v for f, v in values.items()}


def judge(results: Results) -> Sequence[Check]:
    """Judge what halving the default speed changes."""
    checks = []
    for name, flow, key in SERIES:
        values = _read(results, flow, key)
        length = flow.removeprefix("swimmer, ")
        is_judged = flow in ("cylinder", f"swimmer, L = {JUDGED_LENGTH}")
        first, second = values[2.0] - values[1.0], values[1.0] - values[0.5]
        note = (
            f"The first halving changes it {first / second:.2g} times as much as the second; an "
            "effect of the Mach number, which goes with its square, makes that 4, an error of "
            "first order in the time step 2."
        )
        checks.append(
            Check(
                quantity=f"{name}: default speed / half of it",
                ours=values[1.0] / values[0.5],
                reference=1.0,
                source="incompressible flow",
                tolerance=TOLERANCE if is_judged else None,
                resolution=f"D = {DIAMETER}" if flow == "cylinder" else length,
                refinement={_label("", f).removeprefix(", "): v for f, v in values.items()},
                note=note + ("" if flow == "cylinder" else SWIMMER_NOTE),
            )
        )
    return checks


def draw(results: Results) -> Figure:
    """Draw everything against the speed, relative to its value at the lowest."""
    figure = Figure(figsize=(5.5, 3.8), layout="constrained")
    axes = figure.subplots()
    for (name, flow, key), colour in zip(SERIES, COLOURS, strict=False):
        values = _read(results, flow, key)
        speeds = [f * DEFAULT_WALL_SPEED for f in values]
        change = [100.0 * (v / values[min(values)] - 1.0) for v in values.values()]
        axes.plot(speeds, change, "o-", color=colour, label=name)
    axes.axhspan(-100.0 * TOLERANCE, 100.0 * TOLERANCE, color="#eeeeee", zorder=0)
    axes.set(
        xlabel="fastest wall or stream, nodes per step",
        ylabel="change from the lowest speed, %",
        xlim=(0.0, None),
    )
    axes.legend(fontsize=9)
    return figure


SOURCE = "own criterion: halving the speed changes forces and swimming speed by less than 2 %"
CASE = Case("compressibility", __doc__, SOURCE, make_jobs, judge, draw)
