"""Flows of this project, ready to be timed."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any

import torch

from experiments.benchmarks.entry import FISH, KERNEL, WALLS, Entry
from experiments.benchmarks.parts import record_calls
from fishrl.physics import FlowConfig, InPlaceSolver, Scales
from fishrl.physics.cases import make_swimmer_config

CODE = "fishrl"


def make_scales(body_length: int) -> Scales:
    """Return lattice units with the same relaxation time at every length: Re = 70 L."""
    return Scales.from_budget(body_length=body_length, reynolds=70.0 * body_length)


def make_tank(scales: Scales, *, has_fish: bool, **changes: Any) -> FlowConfig:
    """Return the paper's tank, 10 L x 5 L, with a fish in it or without."""
    return make_swimmer_config(scales, **({} if has_fish else {"bodies": ()}) | changes)


def make_solver(
    *,
    body_length: int,
    has_fish: bool,
    num_envs: int = 1,
    num_workers: int = 0,
    device: str = "cpu",
    compile: bool = True,
    **changes: Any,
) -> InPlaceSolver:
    """Return flows in the paper's tank, a fish in the middle of each if there is one.

    Args:
        body_length: L; the tank is 10 L x 5 L.
        has_fish: whether a fish swims in it.
        num_envs: number of flows.
        num_workers: processes that share them; 0 advances them here.
        device: cpu or cuda.
        compile: compile the step.
        **changes: fields of ``FlowConfig``.
    """
    scales = make_scales(body_length)
    config = make_tank(scales, has_fish=has_fish, **changes)
    solver = InPlaceSolver(
        config=config,
        num_envs=num_envs,
        frequency=1.0 / scales.period,
        device=device,
        compile=compile,
        num_workers=num_workers,
    )
    rows = torch.ones(num_envs, dtype=torch.bool, device=device)
    solver.reset_(rows, None, torch.full((num_envs,), pi) if has_fish else None)
    solver.compile()
    return solver


def make_entry(
    solver: InPlaceSolver,
    *,
    label: str,
    how: str,
    num_flows: int | None = None,
    **facts: Any,
) -> Entry:
    """Return the whole step of some of a solver's flows.

    Args:
        solver: from ``make_solver``.
        label: of the entry.
        how: it runs, such as "2 threads".
        num_flows: the first so many flows advance; all by default.
        **facts: of the entry.
    """
    config = solver.config
    num_flows = solver.num_envs if num_flows is None else num_flows
    rows = None
    if num_flows < solver.num_envs:
        rows = torch.arange(solver.num_envs) < num_flows
    return Entry(
        label=label,
        name=f"{describe_size(config, num_flows)}, {how}",
        scope=FISH if config.bodies else WALLS,
        advance=_advance(solver, rows),
        num_nodes=num_flows * config.width * config.height,
        working_set=count_working_set(solver, num_flows),
        bytes_per_update=18 * config.storage.dtype.itemsize,
        multiple=2,
        facts=facts,
    )


def make_kernel_entry(solver: InPlaceSolver, *, label: str, how: str) -> Entry:
    """Return the collision alone: the calls of two real steps, made over and over."""
    calls = record_calls(solver, "collide")

    def advance(num_steps: int) -> None:
        for _ in range(num_steps // 2):
            for function, arguments in calls:
                function(*arguments)

    config = solver.config
    return Entry(
        label=label,
        name=f"{describe_size(config, solver.num_envs)}, {how}",
        scope=KERNEL,
        advance=advance,
        num_nodes=solver.num_envs * config.width * config.height,
        working_set=count_working_set(solver, solver.num_envs),
        multiple=2,
    )


def count_threads(threads: int) -> str:
    """Say on how many threads something runs."""
    return f"{threads} threads" if threads > 1 else "one core"


def describe_size(config: FlowConfig, num_flows: int) -> str:
    """Name a batch, such as "16 × 500 × 250"."""
    return f"{num_flows} × {config.width} × {config.height}"


def count_working_set(solver: InPlaceSolver, num_flows: int) -> int:
    """Return the bytes of the populations of some flows."""
    return round(sum(t.nbytes for t in solver.state_dict().values()) * num_flows / solver.num_envs)


def _advance(solver: InPlaceSolver, rows: torch.Tensor | None) -> Callable[[int], None]:
    if solver.device.type == "cpu":
        return lambda num_steps: solver.advance_(num_steps, rows)

    def advance(num_steps: int) -> None:
        solver.advance_(num_steps, rows)
        torch.cuda.synchronize(solver.device)

    return advance
