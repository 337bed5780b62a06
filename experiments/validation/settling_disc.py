"""Settling disc.

A disc of d = 0.25 cm is let go at (1, 4) cm in a closed box of 2 × 6 cm, g = 980 cm/s², fluid
density 1 g/cm³: *slow*: density ratio 1.25, μ = 0.1 g/(cm s); *fast*: 1.5, 0.01. *Channel*: W = 4
d, 80 d high, ratio 1.5, ν = 0.008088, g = 10 (d = 1), let go a quarter of the width from the wall;
mean over the last third of the time. Half-way bounce-back walls, free body, implicit coupling, top
speed about 0.05 nodes per step. The load is weight less buoyancy of the true disc. Peak Reynolds
numbers of the box are formed with the disc's density, ρ_s v d / μ: with the fluid's, the published
17.2 would mean a drag coefficient of 2.0 between walls 8 d apart, less than that of an unbounded
cylinder (2.00–2.09 at Re = 20). No source that we could see says which is meant. The channel's is v
d / ν, and its drag coefficient agrees with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi, sqrt

from matplotlib.figure import Figure

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Result, Results, check_finest, select
from experiments.validation.convergence import GREY
from experiments.validation.wake import start_flow
from fishrl.physics import Boundaries, Cylinder, FlowConfig, Free, NoSlip

NUM_SAMPLES = 300
SPEED = 0.05
INSET = 0.45  # nodes, the bodies' default
SIZES = (16, 24, 32)
TOLERANCE = 0.04


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A disc and its box, in any consistent units; the fluid's density is 1.

    Args:
        diameter: of the disc.
        width: of the box.
        height: of the box.
        start: centre of the disc (x, y), from the lower left corner.
        density_ratio: disc over fluid.
        viscosity: of the fluid.
        gravity: downwards.
        top_speed: about what the disc reaches; sets the time step.
        duration: the run ends then, or 1.5 diameters above the bottom.
    """

    diameter: float
    width: float
    height: float
    start: tuple[float, float]
    density_ratio: float
    viscosity: float
    gravity: float
    top_speed: float
    duration: float


SLOW = Experiment(  # centimetres, grams, seconds
    diameter=0.25, width=2.0, height=6.0, start=(1.0, 4.0), gravity=980.0,
    density_ratio=1.25, viscosity=0.1, top_speed=5.6, duration=0.9,
)  # fmt: skip
CHANNEL = Experiment(  # in diameters; off the middle, as PacIFiC runs it
    diameter=1.0, width=4.0, height=80.0, start=(1.0, 75.0), gravity=10.0,
    density_ratio=1.5, viscosity=0.008088, top_speed=2.4, duration=60.0,
)  # fmt: skip
EXPERIMENTS = {
    "slow": SLOW,
    "fast": replace(SLOW, density_ratio=1.5, viscosity=0.01, top_speed=14.0, duration=0.5),
    "channel": CHANNEL,
}
PEAK, MEAN = "peak ρ_s v d / μ", "mean v d / ν"
# quantity, what it is called in the results, density in it, reference, source
TARGETS: dict[str, tuple[str, str, float, float | tuple[float, float], str]] = {
    "slow": (PEAK, "reynolds", 1.25, (17.15, 17.45), "Wan & Turek 2006"),
    "fast": (PEAK, "reynolds", 1.5, (438.6, 503.4), "Glowinski 2001 – Wang 2008"),
    "channel": (MEAN, "mean_reynolds", 1.0, 259.5, "Wachs 2009"),
}


def settle(*, experiment: str, nodes: int, speed: float = SPEED, inset: float = 0.0) -> Result:
    """Let a disc, d = ``nodes`` wide, sink from rest in a box with walls all round.

    The markers lie ``inset`` nodes inside. Returns ``time`` and ``velocity`` in the experiment's
    units, the largest v d / nu as ``reynolds`` and its mean over the last third of the time.
    """
    case = EXPERIMENTS[experiment]
    space = case.diameter / nodes
    time = space * speed / case.top_speed
    config = FlowConfig(
        width=round(case.width / space),
        height=round(case.height / space),
        tau=3.0 * case.viscosity * time / space**2 + 0.5,
        bodies=(
            Cylinder(diameter=nodes, density_ratio=case.density_ratio, inset=inset, motion=Free()),
        ),
        boundaries=Boundaries(left=NoSlip(), right=NoSlip(), bottom=NoSlip(), top=NoSlip()),
    )
    start = [c / space - 0.5 for c in case.start]
    solver = start_flow(config, start)
    body = solver.body
    excess = (case.density_ratio - 1.0) * 0.25 * pi * nodes**2
    body.load[:, 1] = -excess * case.gravity * time**2 / space
    stride = 2 * max(1, round(case.duration / time / NUM_SAMPLES / 2))
    times, heights, velocities = [0.0], [case.start[1]], [0.0]
    while times[-1] < case.duration and heights[-1] > 1.5 * case.diameter:
        solver.advance_(stride)
        times.append(times[-1] + stride * time)
        heights.append((float(body.position[0, 1]) + 0.5) * space)
        velocities.append(float(body.velocity[0, 1]) * space / time)
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


def _label(experiment: str, nodes: int, inset: float) -> str:
    return f"{experiment}, d = {nodes}" + (f", inset {inset}" if inset else "")


def make_jobs(quick: bool) -> list[Job]:
    """Return a run for each experiment, resolution and inset."""
    return [
        Job(
            _label(experiment, nodes, inset),
            settle,
            {"experiment": experiment, "nodes": nodes, "inset": inset},
            cost=nodes**3 * (10.0 * 4 * 80 * 80 if experiment == "channel" else 8 * 24 * 400),
        )
        for experiment in (("slow", "fast") if quick else EXPERIMENTS)
        for nodes in (SIZES[:1] if quick else SIZES)
        for inset in ((0.0,) if quick else (0.0, INSET))
    ]


def judge(results: Results) -> Sequence[Check]:
    """Judge peak and mean Reynolds numbers, with markers on the surface and inside."""
    checks = []
    for experiment, (quantity, key, density, reference, source) in TARGETS.items():
        for inset in (0.0, INSET):
            runs = select(results, {n: _label(experiment, n, inset) for n in SIZES})
            values = {n: density * run[key] for n, run in runs.items()}
            where = f", markers {inset} nodes inside" if inset else ""
            name = f"{experiment}: {quantity}{where}"
            if values:
                checks.append(check_finest(name, values, reference, source, TOLERANCE, symbol="d"))
    return checks


def draw(results: Results) -> Figure:
    """Draw velocity against time at each resolution."""
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    for axes, (experiment, case) in zip(figure.subplots(1, 3), EXPERIMENTS.items(), strict=True):
        quantity, _, density, reference, _ = TARGETS[experiment]
        scale = -density * case.diameter / case.viscosity
        clock = sqrt(case.gravity / case.diameter)
        for inset, line in ((0.0, "-"), (INSET, "--")):
            for nodes, colour in zip(SIZES, COLOURS, strict=False):
                label = _label(experiment, nodes, inset)
                if result := results.get(label):
                    time = [clock * t for t in result["time"]]
                    reynolds = [scale * v for v in result["velocity"]]
                    name = label.removeprefix(f"{experiment}, ")
                    axes.plot(time, reynolds, line, color=colour, label=name)
        ends = reference if isinstance(reference, tuple) else (reference,)
        axes.axhspan(min(ends), max(ends), color=GREY, alpha=0.3)
        axes.axhline(max(ends), color=GREY, linewidth=0.8, label="reference")
        name = quantity.partition(" ")[2]
        axes.set(xlabel="time t √(g / d)", ylabel=f"Reynolds number {name}")
        axes.set_title(f"{experiment}: ρ_s / ρ = {case.density_ratio}", loc="left")
        axes.legend(fontsize=8, loc="lower center")
    return figure


SOURCE = (
    "box: Glowinski et al. 2001, J. Comput. Phys. 169; Wan & Turek 2006, Int. J. Numer. Meth. "
    "Fluids 51, 531; Uhlmann 2005; Wang, Fan & Luo 2008, as quoted in open-source codes; "
    "channel: Wachs 2009 and Yu et al. 2002, as quoted in PacIFiC"
)
CASE = Case("settling-disc", __doc__, SOURCE, make_jobs, judge, draw)
