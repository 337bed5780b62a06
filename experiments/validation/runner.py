"""Run the jobs of cases whose results are not cached, and check all results."""

import ast
import inspect
import json
import logging
import multiprocessing
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import torch
from cycler import cycler
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.benchmarks.machine import describe_machine
from experiments.validation import wake
from experiments.validation.case import Case, Check, Job, Runs
from fishrl.files import write_whole
from fishrl.physics.cache_key import hash_sources, make_key, strip_code
from fishrl.programs.figures.style import COLOURS, STYLE, spell_decades, tidy

FIGURE_STYLE: Any = STYLE | {
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.titlelocation": "left",
    "figure.constrained_layout.use": True,
    "legend.fontsize": 8,
}
logger = logging.getLogger(__name__)


@dataclass
class Outcome:
    """What became of a case.

    Attributes:
        case: the case.
        jobs: its runs.
        records: by label, result, seconds and machine of each finished job.
        checks: the checked numbers, failures among them.
        figure: None where there is nothing to draw.
    """

    case: Case
    jobs: Sequence[Job] = ()
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list)
    figure: Figure | None = None

    @property
    def runs(self) -> Runs:
        """Finished runs, in the order of the jobs."""
        labels = [(job, job.label) for job in self.jobs]
        return Runs([(j, self.records[n]["result"]) for j, n in labels if n in self.records])

    @property
    def seconds(self) -> float:
        """Time that the jobs took, one after the other."""
        return float(sum(record["seconds"] for record in self.records.values()))

    def fail(self, what: str, error: BaseException) -> None:
        """Add a check that is missed because of an error."""
        logger.error("%s, %s failed", self.case.name, what, exc_info=error)
        self.checks.append(Check(what, float("nan"), note=f"{type(error).__name__}: {error}"))


def run_cases(
    cases: Sequence[Case],
    *,
    folder: Path,
    quick: bool = False,
    num_workers: int = 1,
    is_fresh: bool = False,
) -> list[Outcome]:
    """Run the jobs without a cached result, or all if ``is_fresh``, and check the results.

    Each job's result is written to ``folder/<case>/<fingerprint>.json`` as soon as it is there, so
    that an interrupted run continues where it was. Cases without jobs, as some are if ``quick``,
    are left out.
    """
    outcomes = [Outcome(case, [j for j in case.jobs if j.is_quick or not quick]) for case in cases]
    outcomes = [outcome for outcome in outcomes if outcome.jobs]
    todo: list[tuple[Outcome, Job, Path]] = []
    for outcome in outcomes:
        for job in outcome.jobs:
            path = folder / outcome.case.name / f"{fingerprint(job)}.json"
            if path.is_file() and not is_fresh:
                outcome.records[job.label] = json.loads(path.read_text(encoding="utf-8"))
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                todo.append((outcome, job, path))
    todo.sort(key=lambda item: -item[1].cost)
    machine = describe_machine()
    futures = _run_jobs([job for _, job, _ in todo], num_workers)
    # without a terminal the log says the same
    is_silent = not sys.stderr.isatty()
    for i, future in tqdm(futures, "validation", len(todo), unit="run", disable=is_silent):
        outcome, job, path = todo[i]
        if error := future.exception():
            outcome.fail(f"run {job.label}", error)
            continue
        result, seconds = future.result()
        logger.info("%s %s: %.1f s", outcome.case.name, job.label, seconds)
        record = {"label": job.label, "seconds": seconds, "machine": machine}
        outcome.records[job.label] = record | {"result": json.loads(result)}
        write_whole(path, json.dumps(outcome.records[job.label], indent=1) + "\n")
    for outcome in outcomes:
        _judge(outcome)
    return outcomes


def _judge(outcome: Outcome) -> None:
    """Fill in checks and figure; a case with a failed job has only its misses."""
    if outcome.checks:
        return
    try:
        outcome.checks.extend(outcome.case.judge(outcome.runs))
        with mpl.rc_context(FIGURE_STYLE):
            outcome.figure = Figure(figsize=outcome.case.size)
            outcome.case.draw(outcome.figure, outcome.runs)
            named = [a for a in outcome.figure.axes if a.get_legend_handles_labels()[0]]
            if not outcome.figure.legends and not any(axes.get_legend() for axes in named):
                for axes in named:
                    axes.legend()
            for axes in outcome.figure.axes:
                spell_decades(axes)
                if not axes.images and axes.get_label() != "<colorbar>":
                    tidy(axes)
    except Exception as error:  # noqa: BLE001 - one case must not cost the report of the others
        outcome.fail("checks", error)


def _run_jobs(
    jobs: Sequence[Job], num_workers: int
) -> Iterator[tuple[int, Future[tuple[str, float]]]]:
    """Yield each job's index and its future when it has ended.

    A process that dies breaks its pool: then the jobs without a result run again, each in a pool
    of its own, so that only the one that died fails.
    """
    broken = []
    with _open_pool(num_workers) as pool:
        indices = {pool.submit(_call, job): i for i, job in enumerate(jobs)}
        for future in as_completed(indices):
            if isinstance(future.exception(), BrokenProcessPool):
                broken.append(indices[future])
            else:
                yield indices[future], future
    for i in broken:
        with _open_pool(1) as pool:
            future = pool.submit(_call, jobs[i])
            wait([future])
            yield i, future


@contextmanager
def _open_pool(num_workers: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool whose processes end with the block, also in the middle of their jobs."""
    # spawned, not forked: a fork of a process with threads (torch has some) may hang
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(num_workers, mp_context=context, initializer=_set_up_process)
    try:
        yield pool
    finally:
        for process in multiprocessing.active_children():
            process.terminate()
        pool.shutdown(cancel_futures=True)


def _set_up_process() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent decides
    tqdm.set_lock(threading.RLock())  # its own is a named semaphore, which termination leaves
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)


def _call(job: Job) -> tuple[str, float]:
    """Return a job's result as JSON, and the seconds of CPU time it took."""
    start = time.process_time()
    text = json.dumps(job.function(**job.arguments))
    return text, time.process_time() - start


def fingerprint(job: Job) -> str:
    """Return a key that changes with everything that may change the job's result.

    It covers the arguments, the module of the function but its ``judge`` and ``draw``, what cases
    share in ``wake.py``, every source file of ``fishrl.physics`` and the version of torch.
    Comments, docstrings and layout do not count.
    """
    name = f"{job.function.__module__}.{job.function.__qualname__}"
    arguments = json.dumps(job.arguments, sort_keys=True)
    modules = sys.modules[job.function.__module__], wake
    sources = [strip_readers(inspect.getsource(module)) for module in modules]
    return make_key(name, arguments, sources, hash_sources(), torch.__version__)


@cache
def strip_readers(source: str) -> str:
    """Return the code of a case without the functions that only read results."""
    tree = ast.parse(source)
    tree.body = [node for node in tree.body if getattr(node, "name", "") not in {"judge", "draw"}]
    return strip_code(ast.unparse(tree))
