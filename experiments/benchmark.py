"""Benchmark solver, environment and training: ``python -m experiments.benchmark`` (``make bench``).

Each code runs in its own process; the processes take turns in short bursts. Tables, goals and
figures show medians and quartiles over the rounds, and ratios of the same round. Codes that are not
installed are left out; ``pip install -e '.[bench]'`` installs lbmpy and numba.

    python -m experiments.benchmark groups=[solver,peers]    # some groups
    python -m experiments.benchmark docs=docs                # put the last results into the page
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from experiments.benchmarks import cuda_code, environment, flows
from experiments.benchmarks.contest import Settings, Team, run_contest
from experiments.benchmarks.machine import describe_machine, describe_surroundings
from experiments.benchmarks.peers import lbmpy_kernels, lettuce_step, numba_kernel, xlb_step
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.report import describe_run, list_tables, write_page
from experiments.benchmarks.results import Results
from experiments.configuration import nearest
from experiments.program import program
from fishrl.bounds import bounded

TEAMS = (
    Team("probe", flows.make_probes, code="torch"),
    Team("solver", flows.make_flows),
    Team("coupled", flows.make_swimmers),
    Team("peers", lbmpy_kernels.make_entries, code="lbmpy"),
    Team("peers", numba_kernel.make_entries, code="numba"),
    Team("peers", lettuce_step.make_entries, code="lettuce"),
    Team("peers", xlb_step.make_entries, code="xlb"),
    Team("gpu", flows.make_gpu),
    Team("env", environment.make_stage, is_long=True),
    Team("train", environment.make_training, is_long=True),
    Team("live", environment.make_live, is_long=True),
    Team("profile", environment.make_profile, is_long=True),
    Team("compile", flows.make_compilation, is_long=True),
    Team("cuda", cuda_code.make_code, is_long=True),
)


@dataclass(frozen=True, kw_only=True)
class BenchmarkSettings(Settings):
    """What to measure, and where to write it.

    Args:
        groups: groups of measurements; by default all.
        folder: of results and figures.
        docs: folder of pages to write stored results of ``folder`` into; nothing is measured.
    """

    body_length: int = bounded(100, least=80)  # a fish has at least 16 nodes, also in a small case
    groups: tuple[str, ...] = ()
    folder: str = "runs/benchmark"
    docs: str | None = None

    def choose_teams(self) -> list[Team]:
        """Return the teams of the groups; the probes always take part.

        Raises:
            ValueError: for a group that does not exist.
        """
        known = [team.group for team in TEAMS]
        for group in self.groups:
            if group not in known:
                raise ValueError(f"groups: there is no {group!r}.{nearest(group, known)}")
        wanted = {"probe", *self.groups} if self.groups else known
        return [team for team in TEAMS if team.group in wanted]


def measure(teams: Sequence[Team], settings: Settings) -> Results:
    """Measure some teams: those of short bursts together, then the others."""
    os.environ["OMP_NUM_THREADS"] = str(settings.threads)  # read by all libraries of the processes
    torch.set_num_threads(settings.threads)
    results = Results(
        machine=describe_machine() | describe_surroundings(), settings=asdict(settings)
    )
    start = time.perf_counter()
    for is_long, num_parallel in ((False, settings.threads), (True, 1)):
        chosen = [team for team in teams if team.is_long == is_long]
        rows, skipped = run_contest(chosen, settings, num_parallel=num_parallel)
        results.rows += rows
        results.skipped += skipped
    results.settings["minutes"] = (time.perf_counter() - start) / 60.0
    return results


@program(BenchmarkSettings)
def main(settings: BenchmarkSettings) -> None:
    """Measure, print tables and write JSON and figures; or write stored results into the page."""
    folder = Path(settings.folder)
    if settings.docs is not None:
        for file in write_page(Results.load(folder / "results.json"), Path(settings.docs)):
            print(f"written: {file}")
        return
    results = measure(settings.choose_teams(), settings)
    results.save(folder / "results.json")
    print("\n\n".join([describe_run(results), *list_tables(results)]))
    write_plots(results, folder)
    print(f"\n{results.settings['minutes']:.1f} minutes; written to {folder}")
    if any(skipped.has_failed for skipped in results.skipped):
        sys.exit(1)


if __name__ == "__main__":
    main()
