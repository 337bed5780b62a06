"""Flows of the case ``levels``, each of which runs with levels or on the finest grid everywhere."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import degrees, pi, radians

import torch

from experiments.validation.case import Result
from experiments.validation.wake import kick, measure_wake, record, start_flow
from fishrl.physics import (
    Bending,
    Boundaries,
    Commanded,
    Cylinder,
    DCylinder,
    Fish,
    FlowConfig,
    Free,
    InPlaceSolver,
    Patch,
    Scales,
    compute_tau,
)
from fishrl.physics.bodies.motion import Motion
from fishrl.physics.boundaries import NonEquilibrium
from fishrl.physics.cases import PERIODIC, make_swimmer_config
from fishrl.physics.flow import FlowState, make_params, make_uniform
from fishrl.physics.levels.grids import Grids, make_patches
from fishrl.physics.step import step

MOVING = NonEquilibrium(velocity=(1.0, 0.0))
EDGES: Mapping[str, Boundaries] = {
    "walls": Boundaries(),
    "moving": Boundaries(left=MOVING, right=MOVING, bottom=MOVING, top=MOVING),
    "stream": Boundaries.make_stream(),
}
MOTIONS: Mapping[str, Motion] = {
    "free": Free(),
    "commanded": Commanded(),
    "bending": Bending(gain=1.0),
}
WINDOW = 3  # samples of a third difference beyond its first


def start_fish(
    *,
    levels: int,
    body_length: int = 100,
    reynolds: float = 1000.0,
    places: Sequence[Sequence[float]] = ((8.5, 2.5),),
    headings: Sequence[float] = (180.0,),
    motion: str = "free",
    edges: str = "walls",
    stream: float = 0.0,
    shared: Sequence[Sequence[float]] | None = None,
) -> tuple[InPlaceSolver, Scales]:
    """Return fish at rest in the water of a domain of 10 L x 5 L, and their scales.

    Args:
        levels: of the grid; those coarser than the finest are outside the patches.
        body_length: L in nodes of the finest level.
        reynolds: L² / (ν T).
        places: centres of mass, L.
        headings: degrees.
        motion: of all fish, by its name in ``MOTIONS``.
        edges: by their name in ``EDGES``.
        stream: speed of the water and of the edges that move, nodes per step.
        shared: corners, L, of one patch that stays and holds all fish.
    """
    unit = max(8, 2**levels)
    scales = Scales.from_budget(body_length=body_length, reynolds=reynolds, multiple=unit)
    fish = Fish(body_length=body_length, motion=MOTIONS[motion])
    config = make_swimmer_config(
        scales,
        bodies=(fish,) * len(places),
        width=10 * body_length + 1,
        height=5 * body_length + 1,
        boundaries=EDGES[edges],
        stream_speed=stream,
    )
    corners = [(x * body_length, y * body_length) for x, y in shared or ()]
    patches = (Patch.between(*corners),) if corners else ()
    config = replace(config, levels=levels, patches=patches if levels > 1 else ())
    solver = InPlaceSolver(config=config, num_envs=1, frequency=1.0 / scales.period, num_workers=0)
    rows = torch.ones(1, dtype=torch.bool)
    position = body_length * torch.tensor([places], dtype=torch.float64)
    heading = torch.tensor([[radians(angle) for angle in headings]], dtype=torch.float64)
    solver.reset_(rows, position, heading, velocity=(1.0, 0.0))
    return solver, scales


def swim(*, turns: Sequence[float] = (), num_beats: int = 4, **given: object) -> Result:
    """Swim some beats from rest.

    Args:
        turns: degrees by which the fish is commanded to turn in each beat.
        num_beats: without ``turns``.
        **given: arguments of ``start_fish``.

    Returns:
        The ``speed`` relative to the stream (L / T) and mean ``power`` of the muscles (rho L^4 /
        T^3) of each fish in each beat, by beats; the angle ``turned`` in all (degrees), the last
        ``places`` (L), the change of the water's mean density, ``mass``, and node ``updates`` per
        beat.
    """
    solver, scales = start_fish(**given)  # type: ignore[arg-type]
    config, length, period = solver.config, scales.body_length, scales.period
    unit = length**2 * scales.reference_speed**2
    drift = torch.tensor([config.stream_speed * period, 0.0], dtype=torch.float64)
    start = [float(body.heading[0] + body.internal_angle[0]) for body in solver.bodies]
    speeds, powers = [], []
    for beat in range(len(turns) or num_beats):
        if turns:
            solver.command_(torch.tensor([radians(turns[beat])]), period)
        before = [(body.position[0].clone(), body.work[0].clone()) for body in solver.bodies]
        solver.advance_(period)
        for body, (place, work) in zip(solver.bodies, before, strict=True):
            speeds.append(float((body.position[0] - place - drift).norm()) / length)
            powers.append(float(body.work[0] - work) / unit)
    if solver.is_diverged().any():
        raise RuntimeError(f"the flow diverged with {given}")
    drho = solver.macroscopic()[0].double() - 1.0
    ends = [float(body.heading[0] + body.internal_angle[0]) for body in solver.bodies]
    return {
        "speed": speeds,
        "power": powers,
        "turned": degrees(sum(ends) - sum(start)),
        "places": [(body.position[0] / length).tolist() for body in solver.bodies],
        "mass": float(drho[solver.find_water()].mean()),
        "updates": config.updates_per_step * period,
    }


def feel_shifts(*, num_beats: int, **given: object) -> Result:
    """Return what shifts of a patch do to the force on a free fish with two levels.

    It is the root mean square of the third differences of the force, averaged over two steps of the
    coarse grid each, of those samples that hold a shift or are next to one, over that of all
    others, ``ratio``; and the number of ``shifts`` after the first beat.
    """
    solver, scales = start_fish(levels=2, **given)  # type: ignore[arg-type]
    unit = 2 * solver.config.coarsest_spacing
    solver.advance_(scales.period)
    num, body = (num_beats - 1) * scales.period // unit, solver.body
    impulse, corners = record(solver, num, unit, lambda: (body.impulse[0], solver.corners[0]))
    jerk = impulse.diff(dim=0).diff(n=WINDOW, dim=0).square().sum(-1)
    has_shift = (corners.diff(dim=0) != 0).flatten(1).any(-1)
    is_near = has_shift.unfold(0, WINDOW + 1, 1).any(-1)
    ratio = (jerk[is_near].mean() / jerk[~is_near].mean()).sqrt()
    return {"ratio": float(ratio), "shifts": int(has_shift.sum())}


def hold(*, levels: int, reynolds: float, diameter: int, is_half: bool = False) -> Result:
    """Hold a cylinder, or half of one with its flat side downstream, in a stream.

    Returns the results of ``measure_wake``, without pictures and series.
    """
    speed = 0.08
    place = (5.0 * diameter, 4.5 * diameter)
    motion = kick(speed, diameter)
    body = (DCylinder if is_half else Cylinder)(diameter=diameter, motion=motion)
    around = Patch(size=(5.0 * diameter, 3.0 * diameter), centre=(6.0 * diameter, place[1]))
    config = FlowConfig(
        width=18 * diameter + 1,
        height=9 * diameter + 1,
        tau=compute_tau(length=diameter, speed=speed, reynolds=reynolds),
        stream_speed=speed,
        bodies=(body,),
        boundaries=Boundaries.make_stream(),
        levels=levels,
        patches=(around,) if levels > 1 else (),
    )
    heading = pi if is_half else 0.0
    solver = start_flow(config, place, heading, stream=(1.0, 0.0))
    every = diameter / speed / 8.0  # eight steps, as levels need
    found = measure_wake(solver, (70.0, 40.0), (2.0, 16.0, 1.0, 8.0), per_travel=every)
    return {name: found[name] for name in ("drag", "lift_amplitude", "strouhal")}


def cross_uniform_flow(*, levels: int) -> Result:
    """Let patches walk at random in a uniform flow; returns its largest ``error``."""
    patch = Patch(bodies=(), size=(40, 40), centre=(80.0, 80.0))
    config = FlowConfig(
        width=160, height=160, tau=0.52, boundaries=PERIODIC, levels=levels, patches=(patch,)
    )
    params = make_params([config])
    width, height = config.coarsest_size
    one = torch.ones(1, height, width, dtype=torch.float64)
    given = make_uniform(0.01 * one, 0.05 * one, -0.03 * one)
    state = make_patches(FlowState(given), config, params)
    random = torch.Generator().manual_seed(1)
    for _ in range(100):
        grids = Grids(state, config, params)
        _, low, high = (torch.tensor(ends) for ends in grids.levels[1].frame)
        by = torch.randint(-1, 2, (1, 2), generator=random)
        goal = grids.origins[1] + by
        by = torch.where((goal >= low) & (goal <= high), by, 0)
        chain = range(1, levels)
        for number in chain:
            grids.fill(number)
        grids.move(chain, [by, *[torch.zeros_like(by)] * (levels - 2)])
        state = step(grids.collect(), config, params)
    inside = state.patches[0].f - given[:, :, :1, :1]
    return {"error": float(max((state.f - given).abs().max(), inside.abs().max()))}
