"""What the memory does: the ceiling that every code is compared with.

A copy reads and writes as many bytes as a step in two buffers, nine arrays that are scaled in place
as many as a step in one; on a CPU the second is faster, as nothing is written that is not in the
cache already.
"""

from __future__ import annotations

import torch
from torch import Tensor

from experiments.benchmarks.entry import PROBE, Entry, Settings, Team


def make_probes(*, num_nodes: int, threads: int) -> list[Entry]:
    """Copy nine populations of ``num_nodes``, and scale as many in place."""
    torch.set_num_threads(threads)
    source = torch.rand(9 * num_nodes)
    target = torch.empty_like(source)
    arrays = [torch.ones(num_nodes) for _ in range(9)]
    megabytes = round(source.nbytes / 1e6)

    def copy(num_steps: int) -> None:
        for _ in range(num_steps):
            target.copy_(source)

    def scale(num_steps: int) -> None:
        for _ in range(num_steps // 2):
            _scale(arrays, 1.25)
            _scale(arrays, 0.8)

    return [
        Entry(
            label="probe/copy",
            name=f"copy of {megabytes} MB",
            scope=PROBE,
            advance=copy,
            num_nodes=num_nodes,
            working_set=2 * source.nbytes,
        ),
        Entry(
            label="probe/in place",
            name=f"nine arrays of {megabytes / 9:.0f} MB scaled in place",
            scope=PROBE,
            advance=scale,
            num_nodes=num_nodes,
            working_set=source.nbytes,
            multiple=2,
        ),
    ]


def _scale(arrays: list[Tensor], factor: float) -> None:
    for array in arrays:
        array.mul_(factor)


def list_probes(settings: Settings) -> list[Team]:
    """Return the probes at the size of the large case."""
    num_nodes = 50 * settings.body_length**2
    arguments = {"num_nodes": num_nodes, "threads": settings.threads}
    return [Team(code="torch", group="probe", make=make_probes, arguments=arguments)]
