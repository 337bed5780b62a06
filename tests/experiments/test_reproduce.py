"""The jobs of a reproduction: each command is one that its program takes; none is run twice."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from experiments import paper, reproduce
from experiments.reproduce import Job, Record, list_jobs, run_job
from fishrl.__main__ import list_programs
from fishrl.physics.flow import Coupling
from fishrl.programs.sweeps.jobs import find_runs, plan_jobs
from fishrl.training.run_folder import write_json
from fishrl.training.runs import make_folder


@pytest.mark.parametrize("name", reproduce.main.command_line.list_choices()["scale"])
def test_every_job_of_a_scale_is_a_command_that_its_program_takes(
    name: str, tmp_path: Path
) -> None:
    scale = reproduce.main.read([f"scale={name}"]).scale
    jobs = list(list_jobs(scale, tmp_path))
    assert len({job.name for job in jobs}) == len(jobs)
    for job in jobs:
        program, *words = job.words
        if words[0] == "--multirun":
            plans = [job.settings for job in plan_jobs(words[1:])]
            assert len(plans) == len(scale.seeds)
        else:
            package = "fishrl.programs" if program in list_programs() else "experiments"
            plans = [import_module(f"{package}.{program.replace('-', '_')}").main.read(words)]
        if program in ("train", "train-lateral-line"):  # the paper's method
            assert {plan.task.coupling for plan in plans} == {Coupling.IMPLICIT}


def list_by_name(folder: Path, *settings: str) -> dict[str, Job]:
    scale = reproduce.main.read(["scale=tiny"]).scale
    scale = replace(scale, gait=(*scale.gait, *settings))
    return {job.name: job for job in list_jobs(scale, folder)}


def test_runs_that_have_begun_are_evaluated(tmp_path: Path) -> None:
    words = list_by_name(tmp_path)["ablation"].words[2:]
    assert find_runs(words) == []
    begin(words)
    assert find_runs(words) == [tmp_path / "ablation" / "run"]
    assert f"runs=[{find_runs(words)[0]}]" in list_by_name(tmp_path)["transfer"].words


def begin(words: Sequence[str]) -> Path:
    """Write the folder of the only run of a sweep, and return it."""
    (job,) = plan_jobs(words)
    return make_folder(job.settings)[0].path


def test_the_newest_classifier_with_results_is_used(tmp_path: Path) -> None:
    for number, (name, is_finished) in enumerate(
        {"classifier": False, "classifier-10": True, "classifier-2": True}.items()
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "machine.pt").touch()
        if is_finished:
            (tmp_path / name / "lateral_line.json").touch()
            os.utime(tmp_path / name / "lateral_line.json", (number, number))
    assert paper.find_fitted(tmp_path) == tmp_path / "classifier-2"
    words = list_by_name(tmp_path)["both"].words
    assert f"recognition={tmp_path / 'classifier-2' / 'machine.pt'}" in words


def test_a_finished_job_is_not_repeated_unless_its_settings_change(tmp_path: Path) -> None:
    job = Job(name="summary", words=("benchmarks.machine",))  # a module that begins in no time
    with reproduce.alone(tmp_path) as lock:
        run_job(job, Record(tmp_path), lock)
    record = Record(tmp_path)
    assert record.is_finished(job) and record.jobs["summary"]["seconds"] > 0
    assert not record.is_finished(Job(name="summary", words=("benchmarks.machine", "elsewhere")))


def test_a_training_whose_run_is_gone_is_repeated(tmp_path: Path) -> None:
    job, record = list_by_name(tmp_path)["ablation"], Record(tmp_path)
    record.note(job, seconds=1.0, is_finished=True)
    assert not record.is_finished(job)
    run = begin(job.words[2:])
    assert not record.is_finished(job)
    write_json(run / "summary.json", {"frames": 16})
    assert record.is_finished(job)


def test_a_job_that_fails_is_not_finished(tmp_path: Path) -> None:
    job = Job(name="summary", words=("nothing",))
    with reproduce.alone(tmp_path) as lock, pytest.raises(ValueError, match="status 1"):
        run_job(job, Record(tmp_path), lock)
    assert not Record(tmp_path).is_finished(job)
