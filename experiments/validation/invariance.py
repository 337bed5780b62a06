"""The same flow shifted, mirrored, turned and in a moving frame must give the same numbers."""

from collections.abc import Sequence
from math import hypot, pi

import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.figures import COLOURS
from experiments.validation.case import Case, Check, Job, Result, Results
from experiments.validation.convergence import tidy
from fishrl.physics import Cylinder, DCylinder, Fish, FlowConfig, InPlaceSolver, Scales
from fishrl.physics.bodies.motion import Driven, Free
from fishrl.physics.bodies.outline import BodyConfig
from fishrl.physics.boundaries import Boundaries, NonEquilibrium

SHIFTS = {
    "¼ node along x": (0.25, 0.0),
    "½ node along x": (0.5, 0.0),
    "¼ node along y": (0.0, 0.25),
    "½ node along y": (0.0, 0.5),
    "½ node along both": (0.5, 0.5),
}
BASE, MIRRORED, MOVING, TURNED = "as it is", "mirrored", "moving frame", "turned by 90°"
DIAMETER = 20
SPEED = 0.05
REYNOLDS = 100.0  # of the cylinders
TILT = 0.4  # of the half disc's axis, rad
TRAVEL = 8  # diameters that the stream goes; the second half is averaged
BODY_LENGTH = 50
FISH_REYNOLDS = 1000.0
NUM_BEATS = 4  # the last two are averaged
FISH_STREAM = 0.02


def _surround(direction: tuple[float, float]) -> Boundaries:
    edge = NonEquilibrium(velocity=direction)
    return Boundaries(left=edge, right=edge, bottom=edge, top=edge)


def _start(
    bodies: BodyConfig,
    places: Sequence[tuple[float, float]],
    headings: Sequence[float],
    streams: Sequence[float],
    *,
    size: tuple[int, int],
    tau: float,
    is_turned: bool,
    frequency: float = 0.0,
) -> InPlaceSolver:
    """Return flows at rest or in a uniform stream; ``is_turned`` turns everything by 90 degrees."""
    width, height = size
    places = [(height - 1.0 - y, x) for x, y in places] if is_turned else list(places)
    headings = [h + 0.5 * pi for h in headings] if is_turned else list(headings)
    direction = (0.0, 1.0) if is_turned else (1.0, 0.0)
    configs = [
        FlowConfig(
            width=height if is_turned else width,
            height=width if is_turned else height,
            tau=tau,
            stream_speed=stream,
            bodies=(bodies,),
            boundaries=_surround(direction),
        )
        for stream in streams
    ]
    solver = InPlaceSolver(config=configs, frequency=frequency, num_workers=0)
    solver.reset_(
        torch.ones(len(places), dtype=torch.bool),
        torch.tensor(places, dtype=torch.float64),
        torch.tensor(headings, dtype=torch.float64),
        velocity=direction,
    )
    return solver


def _turn_back(vectors: Tensor, is_turned: bool) -> Tensor:
    """Return vectors ``[B, 2]`` as they would be without the turn."""
    return torch.stack((vectors[:, 1], -vectors[:, 0]), -1) if is_turned else vectors


def push_cylinders(*, is_half: bool, is_turned: bool) -> Result:
    """Measure the force on cylinders in a stream, and of one that moves through fluid at rest.

    Args:
        is_half: a tilted half disc and its mirror image; else circles, shifted and moving.
        is_turned: the stream goes along +y instead.

    Returns:
        By name: mean force (x, y) / (rho U^2 D / 2), as without the turn.
    """
    size = (30 * DIAMETER, 20 * DIAMETER)
    x, y = 14.0 * DIAMETER, 0.5 * (size[1] - 1.0)
    tau = 3.0 * SPEED * DIAMETER / REYNOLDS + 0.5
    if is_half:
        y += 7.3
        runs = {BASE: ((x, y), pi - TILT, SPEED)}
        runs[MIRRORED] = ((x, size[1] - 1.0 - y), pi + TILT, SPEED)
        body: BodyConfig = DCylinder(diameter=DIAMETER, motion=Driven())
    else:
        runs = {BASE: ((x, y), pi, SPEED)}
        runs |= {name: ((x + dx, y + dy), pi, SPEED) for name, (dx, dy) in SHIFTS.items()}
        runs[MOVING] = ((x + 0.5 * TRAVEL * DIAMETER, y), pi, 0.0)
        body = Cylinder(diameter=DIAMETER, motion=Driven())
    places, headings, streams = zip(*runs.values(), strict=True)
    solver = _start(body, places, headings, streams, size=size, tau=tau, is_turned=is_turned)
    for row, stream in enumerate(streams):
        if stream == 0.0:
            solver.body.velocity[row, 1 if is_turned else 0] = -SPEED
    half = 2 * round(0.5 * TRAVEL * DIAMETER / SPEED / 2)
    solver.advance_(half)
    before = solver.body.impulse.clone()
    solver.advance_(half)
    force = _turn_back(solver.body.impulse - before, is_turned) / half
    return dict(zip(runs, (force / (0.5 * SPEED**2 * DIAMETER)).tolist(), strict=True))


def swim_invariantly(*, is_turned: bool) -> Result:
    """Measure how fast free fish swim from rest.

    Args:
        is_turned: they swim along -y instead of -x.

    Returns:
        By name: mean velocity (x, y) relative to the stream, L / T, as without the turn.
    """
    scales = Scales.from_budget(body_length=BODY_LENGTH, reynolds=FISH_REYNOLDS)
    size = (6 * BODY_LENGTH, 4 * BODY_LENGTH)
    x, y = 3.6 * BODY_LENGTH, 2.1 * BODY_LENGTH
    runs = {BASE: ((x, y), pi, 0.0), MIRRORED: ((x, size[1] - 1.0 - y), pi, 0.0)}
    if not is_turned:
        runs |= {name: ((x + dx, y + dy), pi, 0.0) for name, (dx, dy) in SHIFTS.items()}
        drift = 0.5 * FISH_STREAM * NUM_BEATS * scales.period
        runs[MOVING] = ((x - drift, y), pi, FISH_STREAM)
    places, headings, streams = zip(*runs.values(), strict=True)
    solver = _start(
        Fish(body_length=BODY_LENGTH, motion=Free()), places, headings, streams,
        size=size, tau=scales.tau, is_turned=is_turned, frequency=1.0 / scales.period,
    )  # fmt: skip
    solver.body.phase[list(runs).index(MIRRORED)] = pi
    solver.advance_(NUM_BEATS // 2 * scales.period)
    before = solver.body.position.clone()
    solver.advance_(NUM_BEATS // 2 * scales.period)
    velocity = _turn_back(solver.body.position - before, is_turned)
    velocity = velocity / (NUM_BEATS // 2 * scales.period) / scales.reference_speed
    velocity[:, 0] -= torch.tensor(streams) / scales.reference_speed
    return dict(zip(runs, velocity.tolist(), strict=True))


CYLINDER = "cylinder: force"
HALF_DISC, HALF_DISC_TURNED = "half disc: force", "half disc: force, turned by 90°"
FISH, FISH_TURNED = "fish: speed", "fish: speed, turned by 90°"


def _compare(results: Results) -> dict[str, dict[str, float]]:
    """Return by quantity and by change how far the vector is from that of the flow as it is."""
    table: dict[str, dict[str, float]] = {}
    for label, result in results.items():
        quantity = label.removesuffix(f", {TURNED}")
        base = results[quantity][BASE] if quantity in results else result[BASE]
        size = hypot(*base)
        for name, (x, y) in result.items():
            vector = (x, -y) if name == MIRRORED else (x, y)
            change = name if label == quantity else TURNED if name == BASE else f"{TURNED}, {name}"
            if label.startswith("fish"):
                difference = abs(hypot(*vector) - size)
            else:
                difference = hypot(vector[0] - base[0], vector[1] - base[1])
            if change != BASE:
                table.setdefault(quantity, {})[change] = difference / size
    return table


class Invariance(Case):
    """Bodies shifted, mirrored, turned and seen from a moving frame."""

    name = "invariance"
    title = "Invariance"
    source = "symmetries of the Navier–Stokes equations"
    setup = (
        f"Cylinder and half disc (D = {DIAMETER}, Re = {REYNOLDS:g}, the half disc tilted by "
        f"{TILT} rad) are put into a stream of U = {SPEED} that fills a domain of 30 D × 20 D; "
        f"force averaged from {TRAVEL // 2} to {TRAVEL} D / U. A free fish (L = {BODY_LENGTH}, "
        f"Re_f = {FISH_REYNOLDS:g}) swims from rest in 6 L × 4 L; speed over beats 3 and 4 of "
        f"{NUM_BEATS}. Moving frame: the cylinder moves through fluid at rest; the fish swims "
        f"against a stream of {FISH_STREAM} with all edges moving along, speed relative to it. "
        "Compared is the force as a vector, and the size of the fish's velocity."
    )

    def jobs(self, *, quick: bool) -> Sequence[Job]:
        """Return one job for each body, and one with everything turned."""
        jobs = [Job(label=FISH, function=swim_invariantly, arguments={"is_turned": False})]
        if quick:
            return jobs
        jobs += [Job(label=FISH_TURNED, function=swim_invariantly, arguments={"is_turned": True})]
        runs = ((CYLINDER, False, False), (HALF_DISC, True, False), (HALF_DISC_TURNED, True, True))
        return jobs + [
            Job(
                label=label,
                function=push_cylinders,
                arguments={"is_half": is_half, "is_turned": is_turned},
            )
            for label, is_half, is_turned in runs
        ]

    def judge(self, results: Results) -> Sequence[Check]:
        """Judge the largest difference of each kind."""
        kinds = {
            "shifted by part of a node": tuple(SHIFTS),
            "mirrored": (MIRRORED,),
            "turned by 90°": (TURNED, f"{TURNED}, {MIRRORED}"),
            "in a moving frame": (MOVING,),
        }
        checks = []
        for quantity, table in _compare(results).items():
            for kind, names in kinds.items():
                known = {name: table[name] for name in names if name in table}
                if known:
                    checks.append(
                        Check(
                            quantity=f"{quantity}, {kind}: largest difference",
                            ours=max(known.values()),
                            reference=(0.0, 0.01),
                            source="own bar",
                            refinement=known if len(known) > 1 else {},
                        )
                    )
        return checks

    def draw(self, results: Results) -> Figure:
        """Draw all differences."""
        table = _compare(results)
        rows = [
            (f"{q}, {c}", value) for q, changes in table.items() for c, value in changes.items()
        ]
        figure = Figure(figsize=(8.0, 1.2 + 0.24 * len(rows)), layout="constrained")
        axes = figure.subplots()
        colours = dict(zip(table, COLOURS, strict=False))
        for i, (name, value) in enumerate(rows):
            colour = next(c for quantity, c in colours.items() if name.startswith(quantity))
            axes.plot(max(value, 1e-10), -i, "o", color=colour)
        axes.axvline(0.01, color="#777777", linestyle="--", label="bar")
        axes.set_yticks([-i for i in range(len(rows))], [name for name, _ in rows], fontsize=8)
        axes.set(xscale="log", xlabel="difference from the flow as it is / its size")
        axes.set_title("The same flow shifted, mirrored, turned and moving", loc="left")
        axes.legend(fontsize=9, loc="center")
        tidy(axes)
        return figure
