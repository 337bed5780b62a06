"""Group ``scaling``: the price of a step against the size of the grid and the number of flows."""

from __future__ import annotations

from typing import Any

import torch

from experiments.benchmarks.entry import Entry, Settings, Team
from experiments.benchmarks.flows import (
    CODE,
    count_threads,
    make_entry,
    make_scales,
    make_solver,
)
from experiments.config import CONF, load_config
from fishrl.physics import InPlaceSolver

BATCHES = (1, 2, 8, 32)


def make_flows(*, body_length: int, threads: int, presets: dict[int, str]) -> list[Entry]:
    """Make a swimming fish on grids from L / 4 to 2 L, and batches at L / 2.

    Args:
        body_length: L.
        threads: cores.
        presets: names by body length.
    """
    torch.set_num_threads(threads)

    def add(solver: InPlaceSolver, label: str, how: str, num_flows: int, length: int) -> None:
        facts: dict[str, Any] = {"body_length": length, "period": make_scales(length).period}
        facts |= {"flows": num_flows, "preset": presets.get(length) if num_flows == 1 else None}
        entries.append(make_entry(solver, label=label, how=how, num_flows=num_flows, **facts))

    entries: list[Entry] = []
    for factor in (0.25, 0.5, 1.0, 2.0):
        length = round(factor * body_length)
        solver = make_solver(body_length=length, has_fish=True)
        add(solver, f"grid/{factor:g}", count_threads(threads), 1, length)
    length = body_length // 2
    batch = make_solver(
        body_length=length, has_fish=True, num_envs=max(BATCHES), num_workers=threads
    )
    for n in BATCHES:
        add(batch, f"batch/{n}", "one core each" if n > 1 else "one core", n, length)
    return entries


def list_teams(settings: Settings) -> list[Team]:
    """Return this project's process."""
    presets = {
        load_config("train", [f"preset={path.stem}"]).task["body_length"]: path.stem
        for path in sorted((CONF / "preset").glob("*.yaml"))
    }
    arguments = {
        "body_length": settings.body_length,
        "threads": settings.threads,
        "presets": presets,
    }
    return [Team(code=CODE, group="scaling", make=make_flows, arguments=arguments)]
