"""Slip at the boundary.

A free fish (L = 50, Re_f = 7000) swims for 0.7 T from rest, and a cylinder (D = 20, Re = 100) is
held in a stream for 1.5 D / U after a smooth start. From these states, each force solve runs for 40
readable steps. Slip is the largest difference at a marker between the velocity interpolated from
the nodes, force included, and the velocity of the body, averaged over the second half and divided
by the speed of the tail or the stream.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import pi

import torch
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.plots import name_ticks
from experiments.validation.wake import PINNED, STREAM
from fishrl.physics import Cylinder, Fish, FlowConfig, FlowState, Free, Scales
from fishrl.physics.bodies.state import make_body
from fishrl.physics.boundaries import Boundaries
from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.flow import FlowParams, make_params, make_rest
from fishrl.physics.skins import DirectSolve, ForceSolve, ImmersedBoundary, IterativeForcing
from fishrl.physics.skins.delta import interpolate
from fishrl.physics.skins.immersed_boundary import (
    couple_bodies,
    gather,
    gather_fluid,
    locate_bodies,
    spread,
)
from fishrl.physics.step import step
from fishrl.programs.figures.style import COLOURS

RELAXATIONS = {1.0: "--", 1.7: "-"}  # with the lines of the figure
COUNTS = (1, 2, 3, 4, 6, 10, 20)
DEFAULT = IterativeForcing()
EXACT = DirectSolve(regularisation=1e-13)
DIRECT = {"direct": EXACT, "direct, regularised by 1e-4": DirectSolve()}
NUM_STEPS = 40  # with each solve; the second half is averaged
BODIES = {"fish": "o", "cylinder": "s"}  # with the marks of the figure


def make_fish_flow() -> tuple[FlowConfig, FlowState, float, int]:
    """Return a flow at rest, the speed to compare with and the steps until it is measured."""
    scales = Scales.from_budget(body_length=50, reynolds=7000.0)
    fish = Fish(body_length=50, motion=Free())
    config = FlowConfig(
        width=240, height=120, tau=scales.tau, bodies=(fish,), skin=ImmersedBoundary()
    )
    state = _make_state(config, (140.3, 60.2), 1.0 / scales.period)
    return config, state, scales.tail_speed, round(0.7 * scales.period)


def _make_cylinder_flow() -> tuple[FlowConfig, FlowState, float, int]:
    config = FlowConfig(
        width=200,
        height=120,
        tau=0.53,
        stream_speed=0.05,
        ramp_steps=200,
        bodies=(Cylinder(diameter=20),),
        skin=ImmersedBoundary(),
        boundaries=Boundaries(left=STREAM, right=PINNED, bottom=STREAM, top=STREAM),
    )
    return config, _make_state(config, (60.3, 60.2), 0.0), 0.05, 600


def _make_state(config: FlowConfig, place: tuple[float, float], frequency: float) -> FlowState:
    zero = torch.zeros(1, dtype=torch.float64)
    position = torch.tensor([place], dtype=torch.float64)
    body = make_body(position, zero + pi, zero + frequency)
    return FlowState(make_rest(config, 1), (body,), zero)


def measure_slip(state: FlowState, config: FlowConfig, params: FlowParams) -> float:
    """Return the largest difference between fluid and body at a marker in the next step.

    The velocity is interpolated from the nodes, force included, not taken from the solve.
    """
    fluid, size = compute_macroscopic(state.f.unbind(1)), (config.width, config.height)
    assert isinstance(config.skin, ImmersedBoundary)
    bodies = config.skin, config.bodies, params.bodies, state.bodies
    place = locate_bodies(*bodies, size, fluid.rho.dtype)
    nodes = place.stencil.index_nodes(config.width)
    seen = gather_fluid(fluid, nodes)
    moved, *shares = couple_bodies(*bodies, place, seen)
    body, markers = moved[0], place.outlines[0].markers
    spin = torch.stack((-markers.arm[..., 1], markers.arm[..., 0]), -1)
    wall = body.velocity[:, None] + body.angular_velocity[:, None, None] * spin
    wall = wall + markers.deformation_velocity
    slip = []
    for axis, (u, share) in enumerate(zip((fluid.ux, fluid.uy), shares, strict=True)):
        forced = u + 0.5 * spread(share, nodes, fluid.rho) / fluid.rho
        slip.append(interpolate(gather(forced, nodes), place.stencil.weights) - wall[..., axis])
    return float(torch.stack(slip).double().square().sum(0).sqrt().max())


def compare_solves(*, body: str) -> Result:
    """Run the fish or the cylinder into motion, then continue with each force solve.

    Returns slip / speed of tail or stream; by relaxation, one per number of iterations.
    """
    flow = make_fish_flow() if body == "fish" else _make_cylinder_flow()
    config, start, speed, num_steps = flow
    params = make_params([config])
    for _ in range(num_steps):
        start = step(start, config, params)

    def go_on(solve: ForceSolve, dtype: torch.dtype = torch.float64) -> float:
        state = start._replace(f=start.f.to(dtype))
        own = replace(config, skin=ImmersedBoundary(force_solve=solve))
        slips = []
        for count in range(NUM_STEPS):
            if count >= NUM_STEPS // 2:
                slips.append(measure_slip(state, own, params))
            state = step(state, own, params)
        return sum(slips) / len(slips) / speed

    result: Result = {
        f"relaxation {w}": [go_on(IterativeForcing(num_iterations=k, relaxation=w)) for k in COUNTS]
        for w in RELAXATIONS
    }
    result |= {name: go_on(solve) for name, solve in DIRECT.items()}
    result["direct, float32"] = go_on(EXACT, torch.float32)
    return result


JOBS = [Job(compare_solves, {"body": b}, cost=1e9) for b in BODIES]


def judge(runs: Runs) -> Iterator[Check]:
    """Check the direct solve; record the iterations."""
    for body, run in runs.by("body").items():
        for key, precision, limit in (
            ("direct", "float64", 1e-12),
            ("direct, float32", "float32", 1e-6),
        ):
            name = f"slip / speed of the direct solve, {body}, {precision}"
            yield Check(name, run[key], (0.0, limit), "round-off")
        for w in RELAXATIONS:
            slips = dict(zip(COUNTS, run[f"relaxation {w}"], strict=True))
            name = f"slip / speed, {body}, relaxation {w}"
            resolution = f"{DEFAULT.num_iterations} iterations"
            at = {"at": DEFAULT.num_iterations, "resolution": resolution}
            yield check_refined("K", name, slips, **at)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the slip against the number of iterations."""
    axes = figure.subplots()
    for body, run in runs.by("body").items():
        for (w, line), colour in zip(RELAXATIONS.items(), COLOURS, strict=False):
            axes.loglog(
                COUNTS, run[f"relaxation {w}"], BODIES[body] + line, color=colour,
                markerfacecolor="none", label=f"{body}, relaxation {w}",
            )  # fmt: skip
    name_ticks(axes, COUNTS)
    axes.set(xlabel="iterations per step", ylabel="largest slip / speed of tail or stream")
    axes.set_title("Slip against the number of force iterations")


SOURCE = "no slip; relaxation 1 is the paper's iteration (Zhang et al. 2016)"
CASE = Case("slip", __doc__, SOURCE, JOBS, judge, draw, size=(6.0, 4.0))
