"""From cases to outcomes: known results are read, missing ones computed, all are judged."""

from __future__ import annotations

import json
import logging
import multiprocessing
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
import torch
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.benchmarks.machine import describe_machine
from experiments.figures import STYLE
from experiments.figures.style import tidy
from experiments.validation.case import Case, Check, Job, Result
from experiments.validation.fingerprint import fingerprint
from fishrl.files import staged

logger = logging.getLogger(__name__)


@dataclass
class Outcome:
    """What became of a case.

    Attributes:
        case: the case.
        jobs: its runs.
        records: by label, what each finished job left: result, seconds and machine.
        checks: the judged numbers, failures among them.
        figure: None where there is nothing to draw.
    """

    case: Case
    jobs: Sequence[Job] = ()
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list)
    figure: Figure | None = None

    @property
    def results(self) -> dict[str, Result]:
        """Results by label, in the order of the jobs."""
        labels = [job.label for job in self.jobs if job.label in self.records]
        return {label: self.records[label]["result"] for label in labels}

    @property
    def seconds(self) -> float:
        """Time that the jobs took, one after the other."""
        return sum(record["seconds"] for record in self.records.values())

    def fail(self, what: str, how: str, error: BaseException) -> None:
        """Add a check that is missed because of an error."""
        logger.error("%s, %s: %s", self.case.name, what, how, exc_info=error)
        note = f"{how}: {type(error).__name__}: {error}"
        self.checks.append(Check(quantity=what, ours=float("nan"), note=note))


def run_cases(
    cases: Sequence[Case],
    *,
    folder: Path,
    quick: bool = False,
    num_workers: int = 1,
    is_fresh: bool = False,
) -> list[Outcome]:
    """Run what is not known yet of some cases, and judge them.

    Each job's result is written to ``folder/<case>/<fingerprint>.json`` as soon as it is there, so
    that an interrupted run continues where it was.

    Args:
        cases: to run; those without jobs are left out.
        folder: of the results.
        quick: run each case's quick jobs only.
        num_workers: processes at a time.
        is_fresh: forget what is known of these jobs.
    """
    outcomes = [Outcome(case, jobs) for case in cases if (jobs := case.make_jobs(quick))]
    todo: list[tuple[Outcome, Job, Path]] = []
    for outcome in outcomes:
        (folder / outcome.case.name).mkdir(parents=True, exist_ok=True)
        for job in outcome.jobs:
            path = folder / outcome.case.name / f"{fingerprint(job)}.json"
            if path.is_file() and not is_fresh:
                outcome.records[job.label] = json.loads(path.read_text(encoding="utf-8"))
            else:
                todo.append((outcome, job, path))
    _run(todo, num_workers)
    for outcome in outcomes:
        _judge(outcome)
    return outcomes


def _run(todo: list[tuple[Outcome, Job, Path]], num_workers: int) -> None:
    todo.sort(key=lambda item: -item[1].cost)
    machine = describe_machine() | {"threads": 1}
    futures = _run_jobs([job for _, job, _ in todo], num_workers)
    # without a terminal the log says the same
    is_silent = not sys.stderr.isatty()
    for i, future in tqdm(futures, "validation", len(todo), unit="run", disable=is_silent):
        outcome, job, path = todo[i]
        if error := future.exception():
            outcome.fail(f"run {job.label}", "the run failed", error)
            continue
        result, seconds = future.result()
        logger.info("%s %s: %.1f s", outcome.case.name, job.label, seconds)
        outcome.records[job.label] = {
            "label": job.label,
            "function": f"{job.function.__module__}.{job.function.__qualname__}",
            "arguments": job.arguments,
            "seconds": seconds,
            "machine": machine,
            "result": json.loads(result),
        }
        with staged(path) as stage:
            stage.write_text(json.dumps(outcome.records[job.label], indent=1) + "\n")


def _run_jobs(
    jobs: Sequence[Job], num_workers: int
) -> Iterator[tuple[int, Future[tuple[str, float]]]]:
    """Yield each job's index and its future when it has ended.

    A process that dies breaks its pool: then the jobs without a result run again, each in a pool
    of its own, so that only the one to blame fails.
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
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)


def _call(job: Job) -> tuple[str, float]:
    """Return a job's result as JSON, and the seconds it took."""
    start = time.perf_counter()
    text = json.dumps(job.function(**job.arguments))
    return text, time.perf_counter() - start


def _judge(outcome: Outcome) -> None:
    """Fill in checks and figure; a case with a failed job has nothing but misses."""
    if outcome.checks:
        return
    try:
        outcome.checks.extend(outcome.case.judge(outcome.results))
        with mpl.rc_context(STYLE):
            outcome.figure = outcome.case.draw(outcome.results)
            for axes in outcome.figure.axes:
                if not axes.images and axes.get_label() != "<colorbar>":
                    tidy(axes)
    except Exception as error:  # noqa: BLE001 - one case must not cost the report of the others
        outcome.fail("judging", "judging failed", error)
