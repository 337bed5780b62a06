"""Group ``coupled``: the flow with a swimming fish, and what the ways to solve for its force cost.

The solves are compared in a tank so narrow around the fish, 4 L x 2.5 L, that the body is most of
the work.
"""

from __future__ import annotations

import torch

from experiments.benchmarks.entry import Entry, Settings, Team
from experiments.benchmarks.flows import (
    CODE,
    count_threads,
    make_entry,
    make_scales,
    make_solver,
)
from fishrl.physics import InPlaceSolver
from fishrl.physics.immersed_boundary import DirectSolve, ForceSolve, IterativeForcing

#: From the default to as little slip as single precision can tell; the direct solve costs the same
#: whatever its slip.
SOLVES: dict[str, ForceSolve] = {
    "4 iterations": IterativeForcing(num_iterations=4),
    "20 iterations": IterativeForcing(num_iterations=20),
    "80 iterations": IterativeForcing(num_iterations=80),
    "direct": DirectSolve(),
}
BATCHES = (1, 16, 256)


def make_flows(*, body_length: int, threads: int) -> list[Entry]:
    """Make the flows of group ``solver``, a swimming fish in each."""
    torch.set_num_threads(threads)
    large, small = (
        make_solver(body_length=length, has_fish=True) for length in (body_length, body_length // 4)
    )
    alone = make_solver(body_length=body_length, has_fish=True, num_workers=1)
    batch = make_solver(
        body_length=body_length // 2, has_fish=True, num_envs=16, num_workers=min(threads, 16)
    )
    how = count_threads(threads)
    entries = [
        make_entry(large, label="large/fish", how=how),
        make_entry(alone, label="large/fish, one core", how="one core"),
        make_entry(small, label="small/fish", how=how),
    ]
    for n in (4, 16):
        label = f"batch{n}/fish"
        entries.append(make_entry(batch, label=label, how="one core each", num_flows=n))
    return entries


def make_solves(*, body_length: int, threads: int, batches: tuple[int, ...]) -> list[Entry]:
    """Make each way to solve for the force, in batches of flows."""
    torch.set_num_threads(threads)
    entries = []
    for name, solve in SOLVES.items():
        solver = make_solver(
            body_length=body_length,
            has_fish=True,
            num_envs=max(batches),
            num_workers=min(threads, max(batches)),
            force_solve=solve,
            width=4 * body_length,
            height=5 * body_length // 2,
        )
        scales = make_scales(body_length)
        beat = 2 * (scales.period // 4)
        slip = measure_slip(solver, tail_speed=scales.tail_speed, num_steps=beat)
        for n in batches:
            label = f"solve/{name}/{n}"
            how = f"{name}, one core each" if n > 1 else f"{name}, one core"
            entries.append(make_entry(solver, label=label, how=how, num_flows=n, slip=slip))
    return entries


def measure_slip(solver: InPlaceSolver, *, tail_speed: float, num_steps: int) -> float:
    """Let the first fish swim, and return its slip as a share of the tail's speed.

    Args:
        solver: flows with one fish each.
        tail_speed: nodes per step.
        num_steps: that it swims before, even.

    Returns:
        The largest difference between fluid and skin at a marker, averaged over ten steps.
    """
    first = torch.arange(solver.num_envs) == 0
    solver.advance_(num_steps, first)
    slips = []
    for _ in range(10):
        solver.advance_(2, first)
        slips.append(float(solver.body.slip_error[0]))
    return sum(slips) / len(slips) / tail_speed


def list_teams(settings: Settings) -> list[Team]:
    """Return two processes of this project."""
    large = {"body_length": settings.body_length, "threads": settings.threads}
    middle = {**large, "body_length": settings.body_length // 2, "batches": BATCHES}
    return [
        Team(code=CODE, group="coupled", make=make_flows, arguments=large),
        Team(code=CODE, group="coupled", make=make_solves, arguments=middle),
    ]
