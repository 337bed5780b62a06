"""From cases to outcomes: what is known is read, what is missing is run and written at once."""

from __future__ import annotations

import json
import logging
import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.benchmarks.machine import describe_machine
from experiments.figures import STYLE
from experiments.validation.case import Case, Check, Job, Result
from experiments.validation.fingerprint import fingerprint
from experiments.validation.pool import Start, run_jobs

logger = logging.getLogger(__name__)
_BAR = "{desc} {percentage:3.0f}%|{bar:20}| {n_fmt}/{total_fmt} runs [{elapsed}{postfix}]"


@dataclass
class Outcome:
    """What became of a case.

    Attributes:
        case: the case.
        records: by label, what each finished job left: result, seconds and machine.
        failures: by label, why a job has no result.
        checks: the judged numbers, failures among them.
        figure: None where there is nothing to draw.
    """

    case: Case
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list)
    figure: Figure | None = None

    @property
    def results(self) -> dict[str, Result]:
        """Results by label."""
        return {label: record["result"] for label, record in self.records.items()}

    @property
    def seconds(self) -> float:
        """Time that the jobs took, one after the other."""
        return sum(record["seconds"] for record in self.records.values())


def make_folder(path: Path) -> Path:
    """Make a folder that can be written into.

    Raises:
        ValueError: if that is not possible.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError as error:
        reason = error.strerror or str(error)
        raise ValueError(
            f"folder {path}: cannot be written ({reason}); choose another or change its permissions"
        ) from None


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
    that an interrupted run goes on where it was.

    Args:
        cases: to run; those without jobs are left out.
        folder: of the results.
        quick: run each case's quick jobs only.
        num_workers: processes at a time.
        is_fresh: forget what is known of these jobs.
    """
    if num_workers < 1:
        raise ValueError(f"jobs = {num_workers}: at least one process is needed")
    outcomes: list[Outcome] = []
    todo: list[tuple[Outcome, Job, Path]] = []
    for case in cases:
        jobs = case.jobs(quick=quick)
        if len({job.label for job in jobs}) < len(jobs):
            raise ValueError(f"case {case.name} has two jobs of one label: name them apart")
        if not jobs:
            continue
        outcome = Outcome(case)
        outcomes.append(outcome)
        place = make_folder(folder / case.name)
        for job in jobs:
            path = place / f"{fingerprint(job)}.json"
            if is_fresh:
                path.unlink(missing_ok=True)
            if path.is_file():
                outcome.records[job.label] = json.loads(path.read_text(encoding="utf-8"))
            else:
                todo.append((outcome, job, path))
        if known := len(outcome.records):
            logger.info("%s: %d of %d results are known", case.name, known, len(jobs))
    _run(todo, num_workers)
    for outcome in outcomes:
        _sort(outcome, quick)
        _judge(outcome)
    return outcomes


def _run(todo: Sequence[tuple[Outcome, Job, Path]], num_workers: int) -> None:
    if not todo:
        return
    running: dict[int, str] = {}
    num_done = 0
    machine = describe_machine() | {"threads": 1}
    # the log says the same where there is no terminal to draw on
    bar = tqdm(total=len(todo), desc="validation", bar_format=_BAR, disable=not sys.stderr.isatty())
    events = run_jobs([job for _, job, _ in todo], num_workers=num_workers)
    with bar, closing(events):
        for event in events:
            outcome, job, path = todo[event.index]
            name = f"{outcome.case.name} {job.label}"
            if isinstance(event, Start):
                running[event.index] = name
            else:
                del running[event.index]
                done = event.done
                num_done += 1
                count = f"{num_done}/{len(todo)}"
                if done.result is None:
                    outcome.failures[job.label] = done.error
                    logger.error("%s %s FAILED: %s", count, name, done.error)
                else:
                    outcome.records[job.label] = _write_record(
                        path, job=job, result=done.result, seconds=done.seconds, machine=machine
                    )
                    logger.info("%s %s: %.1f s", count, name, done.seconds)
                bar.update()
            bar.set_postfix_str("; ".join(running.values()))


def _write_record(
    path: Path, *, job: Job, result: Result, seconds: float, machine: dict[str, Any]
) -> dict[str, Any]:
    record = {
        "label": job.label,
        "function": f"{job.function.__module__}.{job.function.__qualname__}",
        "arguments": job.arguments,
        "seconds": seconds,
        "machine": machine,
        "result": result,
    }
    write_whole(path, json.dumps(record, indent=1) + "\n")
    return record


def write_whole(path: Path, text: str) -> None:
    """Write a file at once or not at all."""
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def _sort(outcome: Outcome, quick: bool) -> None:
    """Put the records into the order of the case's own list."""
    labels = [job.label for job in outcome.case.jobs(quick=quick)]
    outcome.records = {name: outcome.records[name] for name in labels if name in outcome.records}


def _judge(outcome: Outcome) -> None:
    """Fill in checks and figure; a case with a failed job has nothing but misses."""
    nothing = float("nan")
    for label, error in outcome.failures.items():
        miss = Check(quantity=f"run {label}", ours=nothing, note=f"the run failed: {error}")
        outcome.checks.append(miss)
    if outcome.failures:
        return
    try:
        outcome.checks.extend(outcome.case.judge(outcome.results))
        with mpl.rc_context(STYLE):
            outcome.figure = outcome.case.draw(outcome.results)
    except Exception as error:  # one case's mistake must not cost the report of the others
        logger.exception("%s cannot be judged", outcome.case.name)
        note = f"judging failed: {type(error).__name__}: {error}"
        outcome.checks.append(Check(quantity="judging", ours=nothing, note=note))
