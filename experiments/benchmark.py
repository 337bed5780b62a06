"""How fast everything is: ``python -m experiments.benchmark`` (``make bench``).

Every code runs in a process of its own, and all take turns in short bursts, so that a machine that
changes its mind does so for all of them; tables, goals and figures are made of medians and
quartiles over the rounds, ratios of the same round. Codes that are not installed are left out with
a word; ``pip install -e '.[bench]'`` brings those that pip can.

    python -m experiments.benchmark --groups solver peers    # some groups
    python -m experiments.benchmark --docs docs              # put the last results into the page
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch

from experiments.benchmarks.contest import run_contest
from experiments.benchmarks.entry import Settings
from experiments.benchmarks.groups import GROUPS, choose_groups
from experiments.benchmarks.machine import describe_machine, describe_surroundings
from experiments.benchmarks.page import write_page
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.probes import list_probes
from experiments.benchmarks.results import Results, Skipped
from experiments.benchmarks.tables import describe_run, list_tables, render_plain
from experiments.command_line import plain_errors, set_up_logging

logger = logging.getLogger(__name__)


def measure(names: Sequence[str], settings: Settings) -> Results:
    """Measure some groups: those of short bursts together, then those of long ones, then the rest.

    Args:
        names: of the groups.
        settings: what they share.
    """
    torch.set_num_threads(settings.threads)
    results = Results(
        machine=describe_machine() | describe_surroundings(),
        settings=asdict(settings) | {"groups": list(names)},
    )
    for is_long, words in ((False, "short bursts"), (True, "long bursts")):
        chosen = [GROUPS[name].list_teams for name in names if GROUPS[name].is_long == is_long]
        teams = [team for list_teams in chosen if list_teams for team in list_teams(settings)]
        if teams:
            probes = [] if is_long else list_probes(settings)
            rows, skipped = run_contest([*probes, *teams], settings, name=words)
            results.rows += rows
            results.skipped += skipped
    for name in names:
        run = GROUPS[name].run
        if run is None:
            continue
        logger.info("%s ...", name)
        try:
            results.studies[name] = run(settings)
        except Exception as problem:  # what was measured before must not be lost
            logger.exception("%s failed", name)
            why = f"{type(problem).__name__}: {problem}"
            results.skipped.append(Skipped("fishrl", name, why, True))
    return results


def report(results: Results) -> None:
    """Print machine, tables and goals."""
    print(describe_run(results))
    for table in list_tables(results):
        print("\n" + render_plain(table))


def main() -> None:
    """Measure, print tables, write JSON and figures; or put what was measured into the page."""
    parser = argparse.ArgumentParser(description="Measure the speed of everything.")
    parser.add_argument(
        "--groups", nargs="+", default=[], metavar="GROUP", help=f"some of: {', '.join(GROUPS)}"
    )
    parser.add_argument("--rounds", type=int, default=15, help="bursts of each case (default 15)")
    parser.add_argument("--burst", type=float, default=0.1, help="seconds of a burst")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="cores of each code")
    parser.add_argument("--body-length", type=int, default=100, help="L of the large case")
    parser.add_argument("--folder", type=Path, default=Path("runs/benchmark"))
    parser.add_argument(
        "--docs", type=Path, help="measure nothing, write the page in this folder from the last run"
    )
    options = parser.parse_args()
    set_up_logging()
    path = options.folder / "results.json"
    with plain_errors():
        if options.docs is not None:
            for file in write_page(Results.load(path), options.docs):
                print(f"written: {file}")
            return
        names = choose_groups(options.groups)
        settings = Settings(
            body_length=options.body_length,
            threads=options.threads,
            rounds=options.rounds,
            burst=options.burst,
        )
        # read by every library that the processes will load
        os.environ["OMP_NUM_THREADS"] = str(settings.threads)
        start = time.perf_counter()
        results = measure(names, settings)
        results.settings["minutes"] = (time.perf_counter() - start) / 60.0
        results.save(path)
        report(results)
        write_plots(results, options.folder)
        print(f"\n{results.settings['minutes']:.1f} minutes; written to {options.folder}")
    sys.exit(1 if any(skipped.has_failed for skipped in results.skipped) else 0)


if __name__ == "__main__":
    main()
