"""Benchmark solver, environment and training: ``python -m experiments.benchmark`` (``make bench``).

The codes take turns in short bursts. Tables, goals and figures show medians and quartiles over the
rounds, and ratios of the same round. Codes that are not installed are left out;
``pip install -e '.[bench]'`` installs lbmpy and numba.

    python -m experiments.benchmark groups=[solver,peers]    # some groups
    python -m experiments.benchmark docs=docs                # put the last results into the page
"""

import logging
import os
import time
from dataclasses import asdict
from pathlib import Path

import torch

from experiments.benchmarks import environment, flows, peers
from experiments.benchmarks.machine import describe_machine
from experiments.benchmarks.measuring import BenchmarkSettings, Results, measure
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.report import describe_run, list_tables, write_page
from fishrl.programs.configuration import unknown
from fishrl.programs.program import program

logger = logging.getLogger(__name__)
#: Group, code, and what makes its cases; an ImportError says that the code is not installed.
GROUPS = (
    ("probe", "torch", flows.make_probes),
    ("solver", "fishrl", flows.make_flows),
    ("coupled", "fishrl", flows.make_swimmers),
    ("peers", "lbmpy", peers.make_lbmpy),
    ("peers", "numba", peers.make_numba),
    ("peers", "lettuce", peers.make_lettuce),
    ("peers", "xlb", peers.make_xlb),
    ("gpu", "fishrl", flows.make_gpu),
    ("env", "fishrl", environment.make_overhead),
    ("train", "fishrl", environment.make_training),
    ("profile", "fishrl", environment.make_profile),
    ("compile", "fishrl", flows.make_compilation),
)


def run(settings: BenchmarkSettings) -> Results:
    """Make the cases of the chosen groups and of the probes, and measure them."""
    known = {group for group, _, _ in GROUPS}
    for group in set(settings.groups) - known:
        raise unknown(group, sorted(known))
    chosen = {"probe", *settings.groups} if settings.groups else known
    os.environ["OMP_NUM_THREADS"] = str(settings.threads)  # read by libraries loaded later
    torch.set_num_threads(settings.threads)
    results = Results(machine=describe_machine(), settings=asdict(settings))
    for group, code, make in GROUPS:
        if group in chosen:
            logger.info("%s: preparing %s ...", group, code)
            try:
                cases = make(settings)
            except ImportError as absent:
                results.left_out.append(f"{code} ({group}): {absent}")
                continue
            for case in cases:
                case.group, case.code = group, code
            results.cases += cases
    measure(results.cases, settings)
    return results


@program(BenchmarkSettings)
def main(settings: BenchmarkSettings) -> None:
    """Measure, print tables and write JSON and figures; or write stored results into the page."""
    folder, start = Path(settings.folder), time.perf_counter()
    if settings.docs is not None:
        docs = Path(settings.docs)
        results = Results.load(folder / "results.json")
        figures = write_plots(results, docs / "figures" / "benchmark")
        write_page(results, figures, docs / "performance.md")
        return
    results = run(settings)
    results.save(folder / "results.json")
    write_plots(results, folder)
    print("\n\n".join([describe_run(results), *list_tables(results)]))
    print(f"\n{(time.perf_counter() - start) / 60.0:.1f} minutes; written to {folder}")


if __name__ == "__main__":
    main()
