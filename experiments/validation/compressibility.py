"""Compressibility.

The free swimmer (L = 70 to 140, Re = 7142) and a cylinder (D = 20, Re = 100, domain 20 D × 10 D,
all edges but the inflow open to sound) are run at 0.14, 0.07 (the default, Mach 0.12) and 0.035
nodes per step; this is the speed of the tail and of the stream. Reynolds number and grid are fixed,
so that viscosity and time step change with the speed. The swimming speed is that of beat 8. Drag is
averaged over 40 D of travel, and lift is its root mean square.
"""

from collections.abc import Iterator

from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs
from experiments.validation.swimmer import make_swim
from experiments.validation.wake import record, start_stream
from fishrl.physics import Cylinder, Fixed
from fishrl.physics.units import DEFAULT_WALL_SPEED

BODY_LENGTHS = (70, 100, 140)
JUDGED_LENGTH = 100
NUM_BEATS = 8
SPEEDS = tuple(factor * DEFAULT_WALL_SPEED for factor in (2.0, 1.0, 0.5))
DIAMETER = 20
REYNOLDS = 100.0
TRAVELS = 120  # diameters that the stream travels; the last third is measured
TOLERANCE = 0.02
HEADLINE = f"swimming speed, L = {JUDGED_LENGTH}: default speed / half of it"
SWIMMER_NOTE = (
    " The effect decreases with resolution, so it comes from the resolution of the body, which "
    "depends on the time step. At L = 50, τ does not permit half the speed."
)


def hold_cylinder(*, speed: float) -> Result:
    """Return mean drag and root-mean-square lift coefficient of a cylinder, wake periodic."""
    travel = round(DIAMETER / speed)
    motion = Fixed(kick_speed=0.2 * speed, kick_steps=4 * travel)
    # edges that let sound out: between pinned edges it rings, and more so the faster the stream
    solver = start_stream(
        Cylinder(diameter=DIAMETER, motion=motion),
        (6.0 * DIAMETER, 5.0 * DIAMETER),
        size=(20 * DIAMETER, 10 * DIAMETER),
        tau=3.0 * speed * DIAMETER / REYNOLDS + 0.5,
        speed=speed,
    )
    samples_per_travel = 20
    gap = max(2, 2 * (travel // (2 * samples_per_travel)))
    solver.advance_(2 * (TRAVELS * travel // 3))
    num, body = TRAVELS * travel // 3 // gap, solver.body
    impulse, force = record(solver, num, gap, lambda: (body.impulse[0], body.hydro_force[0]))
    mean = (impulse[-1] - impulse[0]) / (num * gap)
    lift = force[1:, 1]
    unit = 0.5 * speed**2 * DIAMETER
    return {"drag": float(mean[0]) / unit, "lift": float((lift - lift.mean()).std()) / unit}


JOBS = [
    *(make_swim(n, NUM_BEATS, max_wall_speed=speed) for speed in SPEEDS for n in BODY_LENGTHS),
    *(Job(hold_cylinder, {"speed": u}, cost=200.0 * DIAMETER**3 * TRAVELS / u) for u in SPEEDS),
]


def _read(runs: Runs) -> dict[tuple[str, str], dict[float, float]]:
    """Return each quantity, by its name and the resolution, and by speed."""
    table = {}
    for n in BODY_LENGTHS:
        speeds = runs.read("speed", "max_wall_speed", body_length=n, num_beats=NUM_BEATS)
        last = {speed: values[-1] for speed, values in speeds.items()}
        table[f"swimming speed, L = {n}", f"L = {n}"] = last
    for name, key in (("mean drag", "drag"), ("lift", "lift")):
        table[f"{name} of the cylinder", f"D = {DIAMETER}"] = runs.read(key, "speed")
    return table


def judge(runs: Runs) -> Iterator[Check]:
    """Check what halving the default speed changes."""
    for (name, resolution), values in _read(runs).items():
        fast, default, slow = values.values()
        note = (
            f"The first halving changes it {(fast - default) / (default - slow):.2g} times as much "
            "as the second (4 for a Mach-number effect, which is quadratic; 2 for a first-order "
            "error in the time step)."
        )
        is_judged = resolution in (f"D = {DIAMETER}", f"L = {JUDGED_LENGTH}")
        yield Check(
            f"{name}: default speed / half of it",
            default / slow,
            1.0,
            "incompressible flow",
            TOLERANCE if is_judged else None,
            resolution=resolution,
            refinement={f"{speed:g} nodes per step": value for speed, value in values.items()},
            note=note + ("" if resolution.startswith("D") else SWIMMER_NOTE),
        )


def draw(figure: Figure, runs: Runs) -> None:
    """Draw everything against the speed, relative to its value at the lowest."""
    axes = figure.subplots()
    for (name, _), values in _read(runs).items():
        change = [100.0 * (value / values[SPEEDS[-1]] - 1.0) for value in values.values()]
        axes.plot([*values], change, "o-", label=name)
    axes.axhspan(-100.0 * TOLERANCE, 100.0 * TOLERANCE, color="#eeeeee", zorder=0)
    axes.set(xlabel="fastest wall or stream, nodes per step", xlim=(0.0, None))
    axes.set_ylabel("change from the lowest speed, %")


SOURCE = "own criterion: halving the speed changes forces and swimming speed by less than 2 %"
CASE = Case("compressibility", __doc__, SOURCE, JOBS, judge, draw, headline=HEADLINE)
