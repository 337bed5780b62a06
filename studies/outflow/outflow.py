"""Outflow reflection.

A uniform stream of U = 0.1 with τ = 0.53 flows through 240 × 320 nodes, periodic across the stream.
A Taylor vortex of radius 10 nodes and speed 0.3 U (no circulation, balanced pressure), a plane
sound pulse and a round density pulse (1 %, standard deviation 10 nodes) start 80 nodes upstream of
the outflow. The error is the largest difference from a domain twice as long, upstream of the sponge
if there is one, in the middle 100 rows. It is taken from the time at which the disturbance has left
until a vortex would be 80 nodes past the outflow and reflected sound 128 nodes upstream of it. For
the vortex it is a velocity difference relative to the velocity of the vortex; for the pulses, a
density difference relative to the amplitude of the pulse at the outflow. The outflows are: density
fixed by non-equilibrium extrapolation, also with sponges in which τ rises to 1; open to plane
waves, with a density from means along the edge; and open at each node individually.
"""

from collections.abc import Iterator, Mapping

import torch
from matplotlib.figure import Figure
from torch import Tensor

from experiments.validation.case import Case, Check, Job, Result, Runs, check_refined
from experiments.validation.wake import OPEN, OPEN_SIDE, PINNED, STREAM
from fishrl.physics import FlowConfig, InPlaceSolver, Sponge
from fishrl.physics.boundaries import Boundaries, Boundary, Periodic
from fishrl.physics.collision import compute_equilibrium

WIDTH, HEIGHT, AHEAD = 240, 320, 80  # nodes; the disturbance starts so far ahead of the outflow
RADIUS, SPEED, TAU = 10.0, 0.1, 0.53
VORTEX_SPEED, PULSE = 0.03, 0.01
SOUND = 3.0**-0.5
OUTFLOWS: Mapping[str, tuple[Boundary, int]] = {  # with the length of the sponge
    "pinned density": (PINNED, 0),
    "pinned, sponge 20": (PINNED, 20),
    "pinned, sponge 40": (PINNED, 40),
    "pinned, sponge 80": (PINNED, 80),
    "open to plane waves": (OPEN, 0),
    "open to plane waves, sponge 40": (OPEN, 40),
    "open at each node": (OPEN_SIDE, 0),
}


def _make_vortex(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return density - 1 and velocity of a Taylor vortex: no circulation, pressure in balance."""
    decay = VORTEX_SPEED * torch.exp(0.5 * (1.0 - x * x - y * y))
    return -1.5 * decay * decay, -y * decay, x * decay


def _make_plane_pulse(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return a pulse of sound that runs along x."""
    rho = PULSE * torch.exp(-0.5 * x * x) + 0.0 * y
    return rho, SOUND * rho, 0.0 * rho


def _make_round_pulse(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return a pulse of density at rest, which spreads in circles."""
    rho = PULSE * torch.exp(-0.5 * (x * x + y * y))
    return rho, 0.0 * rho, 0.0 * rho


KINDS = {"vortex": _make_vortex, "plane pulse": _make_plane_pulse, "round pulse": _make_round_pulse}


def disturb_outflow(*, outflow: str, kind: str) -> Result:
    """Send one of ``KINDS`` through one of ``OUTFLOWS``, next to a domain twice as long.

    Returns over time the largest relative difference from the long domain, of velocity (vortex) or
    density (pulses), and its largest value.
    """
    boundary, sponge = OUTFLOWS[outflow]
    is_vortex = kind == "vortex"
    short = _start(boundary, sponge, kind, WIDTH)
    long = _start(boundary, 0, kind, 2 * WIDTH)
    speed = SPEED if is_vortex else SPEED + SOUND
    begin = round((AHEAD + 4.0 * RADIUS) / speed)  # the disturbance is out
    # a vortex: as far behind the outflow; sound: the reflection has left the longest sponge
    end = round(2.0 * AHEAD / speed if is_vortex else AHEAD / speed + 1.6 * AHEAD / (SOUND - SPEED))
    gap = 2 * max(1, (end - begin) // 60)
    arrival = 2 * round(AHEAD / speed / 2.0)
    times: list[int] = []
    errors: list[float] = []
    scale = VORTEX_SPEED
    rows = slice(HEIGHT // 2 - 50, HEIGHT // 2 + 50)  # where a round wave meets the outflow head on
    columns = slice(0, WIDTH - max(sponge, 2))
    for now in (arrival, *range(begin + begin % 2, end, gap)):
        for solver in (short, long):
            solver.advance_(now - (times[-1] if times else 0))
        (rho, u), (rho_long, u_long) = short.macroscopic(), long.macroscopic()
        times.append(now)
        if is_vortex:
            error = (u - u_long[..., :WIDTH]).norm(dim=1)
        else:
            error = (rho - rho_long[..., :WIDTH]).abs()
            if now == arrival:
                scale = float((rho_long - 1.0).abs().max())
        errors.append(float(error[..., rows, columns].max()) / scale)
    return {"time": times[1:], "error": errors[1:], "worst": max(errors[1:]), "height": scale}


def _start(boundary: Boundary, sponge: int, kind: str, width: int) -> InPlaceSolver:
    """Return a flow with a disturbance ``AHEAD`` of where the shorter domain ends."""
    config = FlowConfig(
        width=width,
        height=HEIGHT,
        tau=TAU,
        stream_speed=SPEED,
        boundaries=Boundaries(left=STREAM, right=boundary, bottom=Periodic(), top=Periodic()),
        sponges=(Sponge(length=sponge),) if sponge else (),
    )
    solver = InPlaceSolver(config=config, num_envs=1, num_workers=0)
    y, x = torch.meshgrid(
        torch.arange(HEIGHT).double() - 0.5 * HEIGHT,
        torch.arange(width).double() - (WIDTH - AHEAD),
        indexing="ij",
    )
    rho, u, v = KINDS[kind](x[None] / RADIUS, y[None] / RADIUS)
    solver.set_populations_(torch.stack(compute_equilibrium(rho, SPEED + u, v), 1).float())
    return solver


JOBS = [
    Job(disturb_outflow, {"outflow": outflow, "kind": kind}, cost=1e8 if kind == "vortex" else 3e7)
    for kind in KINDS
    for outflow in OUTFLOWS
]


def judge(runs: Runs) -> Iterator[Check]:
    """Show what each outflow reflects, without a criterion."""
    for kind in KINDS:
        row = runs.read("worst", "outflow", kind=kind)
        yield check_refined("", f"reflected share of a {kind}", row, at="pinned density")


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the error over time behind each outflow."""
    panels = figure.subplots(1, len(KINDS), sharey=True)
    for axes, kind in zip(panels, KINDS, strict=True):
        for outflow, run in runs.by("outflow", kind=kind).items():
            axes.semilogy(run["time"], run["error"], label=outflow)
        axes.set(xlabel="time  [steps]", title=kind)
    panels[0].set_ylabel("error / height of the disturbance")
    lines = panels[0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=4)


SOURCE = "the same flow in a domain twice as long"
CASE = Case("outflow", __doc__, SOURCE, JOBS, judge, draw, size=(10.0, 3.9))
