"""Group ``peers``: other codes on the same grid, in the same rounds, a process each."""

from __future__ import annotations

from experiments.benchmarks.entry import Settings, Team
from experiments.benchmarks.peers import lbmpy_kernels, lettuce_step, numba_kernel, xlb_step


def list_teams(settings: Settings) -> list[Team]:
    """Return the processes of all other codes."""
    grid = {"width": 10 * settings.body_length, "height": 5 * settings.body_length}
    threads = grid | {"threads": settings.threads}
    return [
        Team(code=code, group="peers", make=make, arguments=arguments)
        for code, make, arguments in (
            ("lbmpy", lbmpy_kernels.make_entries, threads | {"num_flows": 16}),
            ("numba", numba_kernel.make_entries, threads),
            ("lettuce", lettuce_step.make_entries, threads),
            ("xlb", xlb_step.make_entries, grid),
        )
    ]
