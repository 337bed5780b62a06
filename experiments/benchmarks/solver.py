"""Group ``solver``: the flow alone."""

from __future__ import annotations

import torch

from experiments.benchmarks.entry import PERIODIC, Entry, Settings, Team
from experiments.benchmarks.flows import (
    CODE,
    count_threads,
    make_entry,
    make_kernel_entry,
    make_solver,
)
from experiments.benchmarks.shear_wave import ShearWave
from fishrl.physics import FlowConfig, InPlaceSolver
from fishrl.physics.cases import PERIODIC as PERIODIC_EDGES
from fishrl.physics.step import make_uniform


def make_flows(*, body_length: int, threads: int) -> list[Entry]:
    """Make the large flow, the small one and batches of the middle one."""
    torch.set_num_threads(threads)
    periodic = make_periodic(10 * body_length, 5 * body_length)
    large, small = (
        make_solver(body_length=length, has_fish=False)
        for length in (body_length, body_length // 4)
    )
    batch = make_solver(
        body_length=body_length // 2, has_fish=False, num_envs=16, num_workers=min(threads, 16)
    )
    how = count_threads(threads)
    step = make_entry(periodic, label="large/periodic", how=how)
    entries = [
        make_kernel_entry(periodic, label="large/kernel", how=how),
        Entry(**vars(step) | {"scope": PERIODIC}),
        make_entry(large, label="large/walls", how=how),
        make_entry(small, label="small/walls", how=how),
    ]
    for n in (4, 16):
        label = f"batch{n}/walls"
        entries.append(make_entry(batch, label=label, how="one core each", num_flows=n))
    return entries


def make_periodic(width: int, height: int, *, compile: bool = True) -> InPlaceSolver:
    """Return a periodic flow; it has damped a shear wave as it should.

    Raises:
        RuntimeError: if it has not.
    """
    wave = ShearWave(width, height)
    config = FlowConfig(width=width, height=height, tau=wave.tau, boundaries=PERIODIC_EDGES)
    solver = InPlaceSolver(config=config, num_workers=0, compile=compile)
    velocity = torch.as_tensor(wave.velocity())[None]
    solver.set_populations_(make_uniform(torch.zeros_like(velocity), velocity, 0.0 * velocity))
    wave.check(lambda n: solver.advance_(n), lambda: solver.macroscopic()[1][0, 0].numpy())
    return solver


def list_teams(settings: Settings) -> list[Team]:
    """Return this project's process."""
    arguments = {"body_length": settings.body_length, "threads": settings.threads}
    return [Team(code=CODE, group="solver", make=make_flows, arguments=arguments)]
