"""Edges of a stream.

A half disc of D = 16 nodes stands in a stream of 0.06 nodes per step at Re = 200, in the domain of
the Kármán gait, 25 D × 12.5 D with the flat side 6.25 D behind the inflow (immersed boundary).
After 60 D / U, 60 D / U are evaluated over whole periods. Vorticity made at an edge is the mean of
|ω| within five nodes of the inflow, and of both sides, relative to its mean in the wake. The edges
are those of `Boundaries.make_stream`, along whose sides the water moves freely; and, as in earlier
versions, sides that move with the stream. To see what nearness costs, each edge is moved away in
turn: the outflow to twice its distance, the inflow by 6.25 D, both sides to twice their distance.
"""

from collections.abc import Iterator
from math import pi
from typing import Any

from matplotlib.figure import Figure

from experiments.validation import wake
from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from fishrl.physics import DCylinder, ImmersedBoundary, diagnostics

DIAMETER, SPEED, REYNOLDS = 16, 0.06, 200.0
WIDTH_D, HEIGHT_D, FACE_D = 25.0, 12.5, 6.25
TRAVELS = (60.0, 60.0)
STRIP = 5  # nodes
NEW, OLD = "free along the sides", "sides move with the stream"
FAR = {"outflow": (25.0, 0.0, 0.0), "inflow": (0.0, 6.25, 0.0), "sides": (0.0, 0.0, 12.5)}
NAMES = {"drag": "C_d", "lift_amplitude": "C_l amplitude", "strouhal": "St"}
LIMITS = {"drag": 0.01, "lift_amplitude": 0.02, "strouhal": 0.02}
MADE_LIMIT = 0.01
OWN = "own criterion"


def shed_between(*, edges: str, far: str = "") -> Result:
    """Shed vortices between ``edges``, of which that named ``far`` is farther away.

    Returns ``measure_wake``'s quantities and the vorticity ``made`` at the inflow and the sides.
    """
    longer, ahead, wider = FAR.get(far, (0.0, 0.0, 0.0))
    d = DIAMETER
    width, height = round((WIDTH_D + longer + ahead) * d), round((HEIGHT_D + wider) * d)
    x = (FACE_D + ahead - 2.0 / (3.0 * pi)) * d
    solver = wake.start_stream(
        DCylinder(diameter=d, motion=wake.kick(SPEED, d)),
        (x, 0.5 * (height - 1)),
        pi,
        size=(width, height),
        tau=3.0 * SPEED * d / REYNOLDS + 0.5,
        speed=SPEED,
        sides=wake.SLIDING if edges == NEW else wake.STREAM,
        skin=ImmersedBoundary(),
    )
    window = (ahead, ahead + WIDTH_D, 0.5 * wider, 0.5 * wider + HEIGHT_D)
    result = wake.measure_wake(solver, TRAVELS, window)
    size = diagnostics.compute_vorticity(solver.macroscopic()[1])[0].abs().double()
    middle = height // 2
    shed = size[middle - d : middle + d, round(x) + d :].mean()
    at_sides = (size[1 : STRIP + 1] + size[-STRIP - 1 : -1]).mean() / 2.0
    made = {"inflow": size[:, 1 : STRIP + 1].mean(), "sides": at_sides}
    return result | {"made": {name: float(value / shed) for name, value in made.items()}}


JOBS = [
    Job(shed_between, {"edges": edges, **far})
    for edges in (NEW, OLD)
    for far in ({}, *({"far": name} for name in FAR))
    if edges == NEW or far in ({}, {"far": "outflow"})
]


def judge(runs: Runs) -> Iterator[Check]:
    """Check what the edges make, and what the nearness of the outflow changes."""
    made = runs.read("made", "edges")
    for name in ("inflow", "sides"):
        values = {edges: shares[name] for edges, shares in made.items()}
        quantity, limits = f"vorticity made at the {name} / in the wake", (0.0, MADE_LIMIT)
        yield check_refined("", quantity, values, limits, OWN, at=NEW, resolution="")
    for key, name in NAMES.items():
        values = runs.read(key, "far", edges=NEW)
        for far in FAR:
            criterion: Any = (1.0, OWN, LIMITS[key]) if far == "outflow" else ()
            quantity = f"{name}: near / with the {far} farther away"
            yield Check(quantity, values[""] / values[far], *criterion)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the vorticity between both kinds of edges."""
    reach = (-FACE_D, WIDTH_D - FACE_D, -0.5 * HEIGHT_D, 0.5 * HEIGHT_D)
    found = runs.by("edges")
    for axes, (edges, run) in zip(figure.subplots(len(found), 1), found.items(), strict=True):
        wake.draw_vorticity(axes, run, reach, limit=0.5)
        axes.set_title(edges)


SOURCE = "none; criteria of our own"
HEADLINE = "vorticity made at the sides / in the wake"
CASE = Case("edges", __doc__, SOURCE, JOBS, judge, draw, (7.6, 7.6), HEADLINE)
