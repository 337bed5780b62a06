"""Self-propelled anguilliform swimmer.

A NACA0012 fish with Carling's gait (a(x) = 0.125 (x + 0.03125) / 1.03125, wavelength L) starts from
rest in a closed tank of 10 L × 5 L at L² / (T ν) = 7142; the tail speed is 0.07 nodes per step
(Mach 0.12) and the amplitude rises over the first beat. The flow moves and turns the fish. Body and
water have equal density, so net force and torque on the skin vanish in every step. Speed is the
displacement of the centre of mass along the tank in a beat; power is that of the muscles, Σ F ·
u_def, averaged over a beat.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import pi
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.wake import record, start_flow
from fishrl.physics import Commanded, Fish, Free, Scales, Section
from fishrl.physics.bodies.gait import GAITS
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.skins import Skin
from fishrl.physics.units import DEFAULT_WALL_SPEED
from fishrl.settings import build

START_BL = 8.5  # of a tank of 10 L
LENGTHS = (50, 70, 100, 140, 200)
NUM_BEATS = 10
VARIANT_LENGTH = 100
VARIED = {"body_length": VARIANT_LENGTH, "num_beats": NUM_BEATS}
VARIANTS: dict[str, dict[str, Any]] = {
    "tank twice as high": {"height_bl": 10.0},
    "markers 0.45 nodes inside": {"inset": 0.45},
    "heading held": {"is_free": False},
    "midline keeps its length": {"keeps_length": True},
    "eel, 8 % thick": {"section": "eel", "thickness": 0.08},
    "eel, midline keeps its length": {"section": "eel", "thickness": 0.08, "keeps_length": True},
}
# Of all refinement steps the last must change the final speed by no more than this.
GRID_CHANGE = 0.05
WAVE_SPEED = 1.0  # of Carling's gait, wavelength L, in L / T
CARLING = "Carling, Williams & Bowtell 1998, J. Exp. Biol. 201, 3143: 0.77 of the wave speed, 2D"
NO_SOURCE = (
    "for comparison only: Carling's swimmer is thinner and has a different amplitude envelope. We "
    "found no other two-dimensional speed of this swimmer published as a number (Gazzola et al. "
    "2011 and Zhu et al. 2021 show curves, IBAMR's eel2d states none, Kern & Koumoutsakos 2006 is "
    "three-dimensional), so the acceptance criterion is convergence."
)


def swim(
    *,
    body_length: int,
    num_beats: int,
    reynolds: float = 7142.0,
    max_wall_speed: float = 0.07,
    height_bl: float = 5.0,
    gait: str = "carling",
    section: str = "naca",
    thickness: float = 0.12,
    keeps_length: bool = False,
    is_free: bool = True,
    inset: float = 0.0,
    skin: str = "immersed-boundary",
) -> Result:
    """Swim along a tank of 10 L x ``height_bl`` from rest; unless ``is_free`` the heading is held.

    Returns ``speed`` along -x (L / T) and mean ``power`` of the muscles (rho L^4 / T^3) of each
    beat; the largest ``slip`` at the end of a beat and the ``tail_speed`` (L / T).
    """
    scales = Scales.from_budget(
        body_length=body_length, reynolds=reynolds, max_wall_speed=max_wall_speed, gait=GAITS[gait]
    )
    fish = Fish(
        body_length=body_length,
        section=Section(section),
        thickness=thickness,
        gait=GAITS[gait],
        keeps_length=keeps_length,
        motion=Free() if is_free else Commanded(),
        inset=inset,
    )
    config = make_swimmer_config(
        scales, height_bl=height_bl, bodies=(fish,), skin=build(Skin, skin)
    )
    place = (START_BL * body_length, 0.5 * height_bl * body_length)
    solver = start_flow(config, place, pi, frequency=1.0 / scales.period)
    body = solver.body
    x, work, slip = record(
        solver,
        num_beats,
        scales.period,
        lambda: (body.position[0, 0], body.work[0], body.slip_error[0]),
    )
    reference = scales.reference_speed
    unit = body_length**4 * reference**2 / body_length**2
    return {
        "speed": (-x.diff() / body_length).tolist(),
        "power": (work.diff() / unit).tolist(),
        "slip": float(slip[1:].max()) / reference,
        "tail_speed": scales.gait.tail_speed,
    }


def make_swim(body_length: int, num_beats: int, **changes: float | str | bool) -> Job:
    """Return a job of ``swim``; ``changes`` are its other arguments."""
    speed = float(changes.get("max_wall_speed", DEFAULT_WALL_SPEED))
    tail_speed = GAITS[str(changes.get("gait", "carling"))].tail_speed
    num_steps = num_beats * tail_speed * body_length / speed
    arguments = {"body_length": body_length, "num_beats": num_beats, **changes}
    return Job(swim, arguments, cost=50.0 * body_length**2 * num_steps)


def draw_speed(axes: Axes, run: Result, *style: Any, **options: Any) -> None:
    """Draw the speed over each beat against time."""
    beats = [beat + 0.5 for beat in range(len(run["speed"]))]
    axes.plot(beats, run["speed"], *style, markersize=3, **options)
    axes.set_xlabel("time  t / T")


JOBS = [
    *(replace(make_swim(n, NUM_BEATS), is_quick=n == LENGTHS[0]) for n in LENGTHS),
    *(make_swim(VARIANT_LENGTH, NUM_BEATS, **changes) for changes in VARIANTS.values()),
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check the convergence of the speed; list the rest for comparison."""
    found = runs.by("body_length", num_beats=NUM_BEATS)
    final = {n: run["speed"][-1] for n, run in found.items()}
    power = {n: run["power"][-1] for n, run in found.items()}
    slip = {n: run["slip"] / run["tail_speed"] for n, run in found.items()}
    speed = f"speed in beat {NUM_BEATS}"
    carling = (0.77 * WAVE_SPEED, CARLING)
    yield check_refined("L", f"{speed}, L / T", final, *carling, note=NO_SOURCE)
    yield check_refined("L", "power of the muscles, ρ L⁴ / T³", power)
    yield check_refined("L", "slip at the skin / tail speed", slip)
    if len(found) < len(LENGTHS):
        return
    coarse, middle, fine = (final[n] for n in LENGTHS[::2])
    ratio = (middle - coarse) / (fine - middle)
    yield Check(
        "change of the speed from L = 140 to 200",
        abs(final[200] / final[140] - 1.0),
        (0.0, GRID_CHANGE),
        "own criterion",
        resolution="L = 140–200",
        note=(
            f"Doubling L from 50 and from 100 changes the speed by {middle - coarse:.3f} "
            f"and {fine - middle:.3f} L / T, a ratio of {ratio:.2f}; extrapolated, the "
            f"limit is {fine + (fine - middle) / (ratio - 1.0):.3f} L / T. On coarse grids "
            "the fish is slower, because its boundary layer is only a few nodes thick."
        ),
    )
    for name, changes in VARIANTS.items():
        changed = runs.get(**VARIED, **changes)["speed"][-1]
        note = f"{final[VARIANT_LENGTH]:.3f} L / T without this change."
        resolution = f"L = {VARIANT_LENGTH}"
        yield Check(f"{speed}, {name}", changed, resolution=resolution, note=note)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw speed against time."""
    left, right = figure.subplots(1, 2, sharey=True)
    found = runs.by("body_length", num_beats=NUM_BEATS)
    for n, run in found.items():
        draw_speed(left, run, "o-", label=f"L = {n}")
    left.set(title="resolution", ylim=(0.0, None), ylabel="speed over each beat  U T / L")
    if len(found) < len(LENGTHS):
        right.remove()
        return
    draw_speed(right, found[VARIANT_LENGTH], "o-", label="unchanged")
    for name, changes in VARIANTS.items():
        draw_speed(right, runs.get(**VARIED, **changes), "o-", label=name)
    right.set_title(f"variants, L = {VARIANT_LENGTH}")


CASE = Case("swimmer", __doc__, CARLING, JOBS, judge, draw, size=(9.0, 4.0))
