"""Benchmark solver, environment and training: ``python -m experiments.benchmark`` (``make bench``).

All cases take turns in short bursts. Tables, goals and figures show medians and quartiles over the
rounds, and ratios of the same round.

    python -m experiments.benchmark groups=[solver,env]      # some groups
    python -m experiments.benchmark docs=docs                # put the results into pages, too
"""

import logging
import os
import time
from dataclasses import asdict
from pathlib import Path

import torch

from experiments.benchmarks import environment, flows, steps
from experiments.benchmarks.machine import describe_machine
from experiments.benchmarks.measuring import BenchmarkSettings, Results, measure
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.report import render_results, write_pages
from fishrl.files import claim
from fishrl.programs.export_policy import read_revision
from fishrl.programs.program import program
from fishrl.settings import unknown

logger = logging.getLogger(__name__)
#: What makes the cases of each group.
GROUPS = {
    "probe": flows.make_probes,
    "solver": flows.make_flows,
    "coupled": flows.make_swimmers,
    "gpu": flows.make_gpu,
    "levels": flows.make_levels,
    "env": environment.make_overhead,
    "train": environment.make_training,
    "steps": steps.make_steps,
    "decisions": steps.make_decisions,
    "tasks": steps.make_tasks,
    "compile": flows.make_compilation,
}


def run(settings: BenchmarkSettings) -> Results:
    """Make the cases of the chosen groups and of the probes, and measure them, on some threads."""
    os.environ["OMP_NUM_THREADS"] = str(settings.threads)  # of the processes that are started
    torch.set_num_threads(settings.threads)
    for group in set(settings.groups) - set(GROUPS):
        raise unknown(group, sorted(GROUPS))
    chosen = {"probe", *(settings.groups or GROUPS)}
    machine = describe_machine() | {"commit": read_revision() or "unknown"}
    results = Results(machine=machine, settings=asdict(settings))
    for group, make in GROUPS.items():
        if group in chosen:
            logger.info("preparing %s ...", group)
            for case in make(settings):
                case.group = group
                results.cases.append(case)
    measure(results.cases, settings)
    return results


@program()
def main(settings: BenchmarkSettings) -> None:
    """Measure, print tables, and write JSON, figures and perhaps the page."""
    folder, start = Path(settings.folder), time.perf_counter()
    with claim(folder / "results.json") as path:
        results = run(settings)
        results.save(path)
        write_plots(results, folder)
        print(render_results(results))
        if settings.docs is not None:
            docs = Path(settings.docs)
            figures = write_plots(results, docs / "figures" / "benchmark")
            write_pages(results, figures, docs)
    print(f"\n{(time.perf_counter() - start) / 60.0:.1f} minutes; written to {folder}")


if __name__ == "__main__":
    main()
