"""Settling disc.

A disc of d = 0.25 cm is released at (1, 4) cm in a closed box of 2 × 6 cm with g = 980 cm/s² and a
fluid density of 1 g/cm³. *Slow*: density ratio 1.25, μ = 0.1 g/(cm s). *Fast*: density ratio 1.5, μ
= 0.01 g/(cm s). *Channel*: W = 4 d, 80 d high, density ratio 1.5, ν = 0.008088, g = 10 (d = 1),
released at a quarter of the width from the wall; mean over the last third of the time. Walls are
half-way bounce-back, the body is free, its skin the immersed boundary or
bounce-back, and the greatest speed is about 0.05 nodes per step. The load is the weight minus the
buoyancy of the exact disc. The peak Reynolds numbers of the box use the density of the disc, ρ_s v
d / μ. With that of the fluid, the published 17.2 would imply a drag coefficient of 2.0 between
walls 8 d apart, less than that of an unbounded cylinder (2.00–2.09 at Re = 20); no source available
to us states which density is used. In the channel the Reynolds number is v d / ν, which is
consistent with its drag coefficient.
"""

from collections.abc import Iterator
from math import pi, sqrt
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, as_range, check_refined
from experiments.validation.plots import GREY
from experiments.validation.wake import make_even, start_flow
from fishrl.physics import Boundaries, Cylinder, FlowConfig, Free, NoSlip
from fishrl.physics.skins import Skin
from fishrl.programs.figures.style import COLOURS
from fishrl.settings import build

NUM_SAMPLES = 300
SPEED = 0.05
SKINS: dict[str, dict[str, Any]] = {
    "": {"inset": 0.0},
    ", markers 0.45 nodes inside": {"inset": 0.45},  # the default
    ", bounce-back": {"skin": "bounce-back"},
}
SIZES = (16, 24, 32)
TOLERANCE = 0.04


class Experiment(NamedTuple):
    """A disc and its box, in any consistent units; the fluid's density is 1."""

    diameter: float
    width: float  # of the box
    height: float
    start: tuple[float, float]  # centre of the disc (x, y), from the lower left corner
    gravity: float  # downwards
    density_ratio: float  # disc over fluid
    viscosity: float
    top_speed: float  # about what the disc reaches; sets the time step
    duration: float  # the run ends then, or 1.5 diameters above the bottom


EXPERIMENTS = {
    # centimetres, grams, seconds
    "slow": Experiment(0.25, 2.0, 6.0, (1.0, 4.0), 980.0, 1.25, 0.1, 5.6, 0.9),
    "fast": Experiment(0.25, 2.0, 6.0, (1.0, 4.0), 980.0, 1.5, 0.01, 14.0, 0.5),
    # diameters; off the middle, as PacIFiC runs it
    "channel": Experiment(1.0, 4.0, 80.0, (1.0, 75.0), 10.0, 1.5, 0.008088, 2.4, 60.0),
}
PEAK, MEAN = "peak ρ_s v d / μ", "mean v d / ν"
# quantity, what it is called in the results, density in it, reference, source
TARGETS: dict[str, tuple[str, str, float, Any, str]] = {
    "slow": (PEAK, "reynolds", 1.25, (17.15, 17.45), "Wan & Turek 2006"),
    "fast": (PEAK, "reynolds", 1.5, (438.6, 503.4), "Glowinski 2001 – Wang 2008"),
    "channel": (MEAN, "mean_reynolds", 1.0, 259.5, "Wachs 2009"),
}


def settle(
    *, experiment: str, nodes: int, inset: float = 0.0, skin: str = "immersed-boundary"
) -> Result:
    """Let a disc, ``nodes`` wide, sink from rest in a box with walls all round.

    Returns ``time`` and ``velocity`` in the experiment's units, the largest v d / nu as
    ``reynolds`` and its mean over the last third of the time.
    """
    case = EXPERIMENTS[experiment]
    space = case.diameter / nodes
    time = space * SPEED / case.top_speed
    density = case.density_ratio
    body = Cylinder(diameter=nodes, density_ratio=density, motion=Free(), inset=inset)
    config = FlowConfig(
        width=round(case.width / space),
        height=round(case.height / space),
        tau=3.0 * case.viscosity * time / space**2 + 0.5,
        bodies=(body,),
        skin=build(Skin, skin),
        boundaries=Boundaries(left=NoSlip(), right=NoSlip(), bottom=NoSlip(), top=NoSlip()),
    )
    solver = start_flow(config, [c / space - 0.5 for c in case.start])
    disc = solver.body
    excess = (density - 1.0) * 0.25 * pi * nodes**2
    disc.load[:, 1] = -excess * case.gravity * time**2 / space
    stride = make_even(case.duration / time / NUM_SAMPLES)
    times, heights, velocities = [0.0], [case.start[1]], [0.0]
    while times[-1] < case.duration and heights[-1] > 1.5 * case.diameter:
        solver.advance_(stride)
        times.append(times[-1] + stride * time)
        heights.append((float(disc.position[0, 1]) + 0.5) * space)
        velocities.append(float(disc.velocity[0, 1]) * space / time)
    if bool(solver.is_diverged().any()):
        raise RuntimeError("the flow diverged: lower the speed or give the disc more nodes")
    scale = case.diameter / case.viscosity
    late = 2 * len(times) // 3
    return {
        "time": times,
        "velocity": velocities,
        "reynolds": -min(velocities) * scale,
        "mean_reynolds": float((heights[late] - heights[-1]) / (times[-1] - times[late]) * scale),
    }


JOBS = [
    Job(
        settle,
        {"experiment": experiment, "nodes": nodes, **skin},
        cost=nodes**3 * (10.0 * 4 * 80 * 80 if experiment == "channel" else 8 * 24 * 400),
        is_quick=experiment != "channel" and nodes == SIZES[0] and not where,
    )
    for experiment in EXPERIMENTS
    for nodes in SIZES
    for where, skin in SKINS.items()
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check peak and mean Reynolds numbers with each skin."""
    for experiment, (quantity, key, density, *criterion) in TARGETS.items():
        for where, skin in SKINS.items():
            numbers = runs.read(key, "nodes", experiment=experiment, **skin)
            values = {nodes: density * number for nodes, number in numbers.items()}
            name = f"{experiment}: {quantity}{where}"
            if values:
                yield check_refined("d", name, values, *criterion, TOLERANCE)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw velocity against time at each resolution."""
    for axes, (name, case) in zip(figure.subplots(1, 3), EXPERIMENTS.items(), strict=True):
        quantity, _, density, reference, _ = TARGETS[name]
        scale = -density * case.diameter / case.viscosity
        clock = sqrt(case.gravity / case.diameter)
        for (where, skin), line in zip(SKINS.items(), ("-", "--", ":"), strict=True):
            found = runs.by("nodes", experiment=name, **skin)
            for (nodes, run), colour in zip(found.items(), COLOURS, strict=False):
                time = [clock * t for t in run["time"]]
                reynolds = [scale * v for v in run["velocity"]]
                axes.plot(time, reynolds, line, color=colour, label=f"d = {nodes}{where}")
        low, high = as_range(reference)
        axes.axhspan(low, high, color=GREY, alpha=0.3)
        axes.axhline(high, color=GREY, linewidth=0.8, label="reference")
        axes.set(xlabel="time t √(g / d)", ylabel=f"Reynolds number {quantity.partition(' ')[2]}")
        axes.set_title(f"{name}: ρ_s / ρ = {case.density_ratio}")
        axes.legend(loc="lower center")


SOURCE = (
    "box: Glowinski et al. 2001, J. Comput. Phys. 169; Wan & Turek 2006, Int. J. Numer. Meth. "
    "Fluids 51, 531; Uhlmann 2005; Wang, Fan & Luo 2008, as quoted in open-source codes; "
    "channel: Wachs 2009 and Yu et al. 2002, as quoted in PacIFiC"
)
CASE = Case("settling-disc", __doc__, SOURCE, JOBS, judge, draw, size=(11.0, 3.6))
