"""Benchmark solver, environment and training: ``python -m experiments.benchmark`` (``make bench``).

Each code runs in its own process; the processes take turns in short bursts. Tables, targets and
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
from dataclasses import asdict
from pathlib import Path

import torch

from experiments.benchmarks import environment, flows
from experiments.benchmarks.comparison import BenchmarkSettings, Job, compare_codes
from experiments.benchmarks.machine import describe_machine, describe_surroundings
from experiments.benchmarks.peers import lbmpy_kernels, lettuce_step, numba_kernel, xlb_step
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.report import describe_run, list_tables, write_page
from experiments.benchmarks.results import Results
from experiments.program import program
from fishrl.bounds import suggest

JOBS = (
    Job("probe", flows.make_probes, code="torch"),
    Job("solver", flows.make_flows),
    Job("coupled", flows.make_swimmers),
    Job("peers", lbmpy_kernels.make_cases, code="lbmpy"),
    Job("peers", numba_kernel.make_cases, code="numba"),
    Job("peers", lettuce_step.make_cases, code="lettuce"),
    Job("peers", xlb_step.make_cases, code="xlb"),
    Job("gpu", flows.make_gpu),
    Job("env", environment.make_overhead, is_long=True),
    Job("train", environment.make_training, is_long=True),
    Job("live", environment.make_live, is_long=True),
    Job("profile", environment.make_profile, is_long=True),
    Job("compile", flows.make_compilation, is_long=True),
)


def choose_jobs(groups: Sequence[str]) -> list[Job]:
    """Return the jobs of some groups, by default of all; the probes always take part.

    Raises:
        ValueError: for a group that does not exist.
    """
    known = [job.group for job in JOBS]
    for group in groups:
        if group not in known:
            raise ValueError(f"groups: there is no {group!r}{suggest(group, known)}")
    wanted = {"probe", *groups} if groups else known
    return [job for job in JOBS if job.group in wanted]


def measure(jobs: Sequence[Job], settings: BenchmarkSettings) -> Results:
    """Measure some jobs: those of short bursts together, then the others."""
    os.environ["OMP_NUM_THREADS"] = str(settings.threads)  # read by all libraries of the processes
    torch.set_num_threads(settings.threads)
    machine = describe_machine() | describe_surroundings()
    results, start = Results(machine=machine, settings=asdict(settings)), time.perf_counter()
    for is_long, num_parallel in ((False, settings.threads), (True, 1)):
        chosen = [job for job in jobs if job.is_long == is_long]
        rows, skipped = compare_codes(chosen, settings, num_parallel=num_parallel)
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
    results = measure(choose_jobs(settings.groups), settings)
    results.save(folder / "results.json")
    print("\n\n".join([describe_run(results), *list_tables(results)]))
    write_plots(results, folder)
    print(f"\n{results.settings['minutes']:.1f} minutes; written to {folder}")
    if any(skipped.has_failed for skipped in results.skipped):
        sys.exit(1)


if __name__ == "__main__":
    main()
