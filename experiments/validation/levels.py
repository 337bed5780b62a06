"""Levels.

Grids of different spacing against the finest one everywhere. A NACA0012 fish with Carling's gait
and `BounceBack()` swims freely from rest in a closed tank of 10 L × 5 L, with L = 100 near it and
two coarser levels around, and with L = 64 and one; deviations are the largest of all beats after
the first, in which it hardly moves. A cylinder of D = 20 nodes in a stream of 18 D × 9 D, Re = 100,
sheds vortices that leave its patch of 5 D × 3 D. Uniform flow crosses patches that walk at random
(double precision). The water in the tank must not become more or less.
"""

from collections.abc import Iterator
from math import pi

import torch
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs
from experiments.validation.wake import kick, measure_wake, start_flow
from fishrl.physics import Boundaries, Cylinder, Fish, FlowConfig, Free, Patch, Scales, compute_tau
from fishrl.physics.cases import PERIODIC, make_swimmer_config
from fishrl.physics.flow import FlowState, make_params, make_uniform
from fishrl.physics.levels.grids import fill_patches, make_patches, move_patch, plan_levels
from fishrl.physics.placement import find_water
from fishrl.physics.step import step

NUM_BEATS, START_BL = 10, 8.5
# body length, levels, Reynolds number
SWIMMERS = ((100, 3, 500.0), (100, 3, 7142.0), (64, 2, 7142.0))
SPEED_LIMIT, POWER_LIMIT, MASS_LIMIT = 0.003, 0.007, 5e-6
WAKE_LIMITS = {"drag": 0.002, "lift_amplitude": 0.01, "strouhal": 0.003}
WAKE_NAMES = {"drag": "C_d", "lift_amplitude": "C_l amplitude", "strouhal": "St"}
ROUND_OFF = 1e-15
OWN = "own criterion"


def swim_refined(*, body_length: int, levels: int, reynolds: float) -> Result:
    """Swim along a tank from rest.

    Returns ``speed`` along -x (L / T) and mean ``power`` of the muscles (rho L^4 / T^3) of each
    beat, the change of the water's mean density, ``mass``, and node ``updates`` per beat.
    """
    scales = Scales.from_budget(body_length=body_length, reynolds=reynolds, multiple=8)
    width, height = 10 * body_length + 1, 5 * body_length + 1
    fish = Fish(body_length=body_length, motion=Free())
    config = make_swimmer_config(scales, bodies=(fish,), width=width, height=height, levels=levels)
    place = (START_BL * body_length, 2.5 * body_length)
    solver = start_flow(config, place, pi, frequency=1.0 / scales.period)
    body, unit = solver.body, body_length**4 * scales.reference_speed**2 / body_length**2
    speeds, powers = [], []
    for _ in range(NUM_BEATS):
        x, work = body.position[0, 0].clone(), body.work[0].clone()
        solver.advance_(scales.period)
        speeds.append(float(x - body.position[0, 0]) / body_length)
        powers.append(float(body.work[0] - work) / unit)
    if solver.is_diverged().any():
        raise RuntimeError(f"the flow diverged at L = {body_length} with {levels} levels")
    drho = solver.macroscopic()[0].double() - 1.0
    water = find_water([solver.markers()], config, torch.ones_like(drho, dtype=torch.bool))
    return {
        "speed": speeds,
        "power": powers,
        "mass": float(drho[water].mean()),
        "updates": config.updates_per_step * scales.period,
    }


def hold_cylinder(*, levels: int) -> Result:
    """Hold a cylinder in a stream; returns the results of ``measure_wake``."""
    diameter, reynolds, speed = 20, 100.0, 0.08
    place = (5.0 * diameter, 4.5 * diameter)
    body = Cylinder(diameter=diameter, motion=kick(speed, diameter))
    around = Patch(size=(5.0 * diameter, 3.0 * diameter), centre=(6.0 * diameter, place[1]))
    config = FlowConfig(
        width=18 * diameter + 1,
        height=9 * diameter + 1,
        tau=compute_tau(length=diameter, speed=speed, reynolds=reynolds),
        stream_speed=speed,
        bodies=(body,),
        boundaries=Boundaries.make_stream(),
        levels=levels,
        patches=(around,),
    )
    solver = start_flow(config, place, stream=(1.0, 0.0))
    return measure_wake(
        solver,
        diameter=diameter,
        speed=speed,
        travels=(70.0, 40.0),
        window=(2.0, 16.0, 1.0, 8.0),
        is_shedding=True,
    )


def cross_uniform_flow(*, levels: int) -> Result:
    """Let patches walk at random in a uniform flow; returns its largest ``error``."""
    patch = Patch(bodies=(), size=(40, 40), centre=(80.0, 80.0))
    config = FlowConfig(
        width=160, height=160, tau=0.52, boundaries=PERIODIC, levels=levels, patches=(patch,)
    )
    params, root = make_params([config]), plan_levels(config)
    width, height = config.coarsest_size
    one = torch.ones(1, height, width, dtype=torch.float64)
    given = make_uniform(0.01 * one, 0.05 * one, -0.03 * one)
    state = make_patches(FlowState(given), config, params)
    random = torch.Generator().manual_seed(1)
    low, high = (torch.tensor(ends) for ends in root.patches[0].frame[1:])
    for _ in range(100):
        by = torch.randint(-1, 2, (1, 2), generator=random)
        goal = state.patches[0].origin + by
        by = torch.where((goal >= low) & (goal <= high), by, 0)
        state = fill_patches(state, root, params)
        state = state._replace(patches=(move_patch(state.patches[0], by),))
        state = step(state, config, params)
    inside = state.patches[0].flow.f - given[:, :, :1, :1]
    return {"error": float(max((state.f - given).abs().max(), inside.abs().max()))}


def list_jobs() -> Iterator[Job]:
    """Return each flow with levels and without."""
    for length, num, reynolds in SWIMMERS:
        for levels in (num, 1):
            arguments = {"body_length": length, "levels": levels, "reynolds": reynolds}
            yield Job(swim_refined, arguments, cost=1e4 * length**3 / 4**levels)
    for levels in (2, 1):
        yield Job(hold_cylinder, {"levels": levels}, cost=1e9 / levels)
    yield Job(cross_uniform_flow, {"levels": 3}, cost=1e7)


def judge(runs: Runs) -> Iterator[Check]:
    """Compare with the finest grid everywhere."""
    for length, levels, reynolds in SWIMMERS:
        found = runs.by("levels", body_length=length, reynolds=reynolds)
        refined, uniform = found[levels], found[1]
        ratio = uniform["updates"] / refined["updates"]
        at = f"L = {length}, Re = {reynolds:g}, {levels} levels"
        for name, limit in (("speed", SPEED_LIMIT), ("power", POWER_LIMIT)):
            pairs = list(zip(refined[name], uniform[name], strict=True))[1:]
            largest = max((a / b for a, b in pairs), key=lambda r: abs(r - 1.0))
            mean = sum(a for a, _ in pairs) / sum(b for _, b in pairs)
            note = f"{ratio:.1f} times fewer node updates. " if name == "speed" else ""
            yield Check(
                f"{name} / uniform, {at}",
                largest,
                1.0,
                OWN,
                limit,
                resolution=f"L = {length}",
                note=f"{note}Single beats scatter, the largest deviation is given; that of beats 2 "
                f"to {NUM_BEATS} together is {100.0 * (mean - 1.0):+.2f} %.",
            )
        yield Check(
            f"change of mean density less uniform, {at}",
            refined["mass"] - uniform["mass"],
            0.0,
            OWN,
            MASS_LIMIT,
            is_absolute=True,
            note="At the edges of a patch mass is conserved only to the error of interpolation, "
            "which vortices that leave make larger at the higher Reynolds number. After "
            f"{NUM_BEATS} beats; on the uniform grid {uniform['mass']:.1e}.",
        )
    wakes = {
        job.arguments["levels"]: r for job, r in runs.finished if job.function is hold_cylinder
    }
    for name, limit in WAKE_LIMITS.items():
        yield Check(
            f"cylinder: {WAKE_NAMES[name]} / uniform, Re = 100, 2 levels",
            wakes[2][name] / wakes[1][name],
            1.0,
            OWN,
            limit,
            resolution="D = 20",
            note=f"Uniform {wakes[1][name]:.4f}.",
        )
    crossing = next(r for job, r in runs.finished if job.function is cross_uniform_flow)
    yield Check(
        "uniform flow: largest error of a population, 3 levels",
        crossing["error"],
        0.0,
        "exact",
        ROUND_OFF,
        is_absolute=True,
    )


def draw(figure: Figure, runs: Runs) -> None:
    """Draw speed and power of each beat, relative to the uniform grid."""
    every = figure.subplots(1, 2)
    for axes, name in zip(every, ("speed", "power"), strict=True):
        for length, levels, reynolds in SWIMMERS:
            found = runs.by("levels", body_length=length, reynolds=reynolds)
            pairs = zip(found[levels][name], found[1][name], strict=True)
            values = [100.0 * (a / b - 1.0) for a, b in pairs][1:]
            label = f"L = {length}, {levels} levels, Re = {reynolds:g}"
            axes.plot(range(2, NUM_BEATS + 1), values, "o-", markersize=3, label=label)
        axes.axhline(0.0, color="0.7", linewidth=0.8, zorder=0)
        axes.set(xlabel="beat", ylabel=f"{name} against uniform, %")
    figure.legend(*every[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)


CASE = Case(
    "levels", __doc__, "the finest grid everywhere", list(list_jobs()), judge, draw, size=(8.0, 3.4)
)
