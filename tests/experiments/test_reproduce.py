"""The jobs of a reproduction: each command is one that its program takes; none is run twice."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

from experiments import reproduce
from experiments.program import list_choices
from experiments.reproduce import Job, Record, list_jobs, run_job
from experiments.sweeps.jobs import plan_jobs
from fishrl.training.run_folder import RunFolder, write_yaml


@pytest.mark.parametrize("name", list_choices()["scale"])
def test_every_job_of_a_scale_is_a_command_that_its_program_takes(
    name: str, tmp_path: Path
) -> None:
    scale = reproduce.main.read([f"scale={name}"]).scale
    run = RunFolder.create(parent=str(tmp_path / "both"), name="seed_0")
    write_yaml(run.config, {"task": {}})
    jobs = list_jobs(scale, tmp_path)
    assert len({job.name for job in jobs}) == len(jobs)
    for job in jobs:
        program, *words = job.words
        if words[0] == "--multirun":
            assert len(plan_jobs(words[1:])) == len(scale.seeds)
        else:
            settings = import_module(f"experiments.{program}").main.read(words)
            assert program != "transfer" or list(settings.runs) == [str(run.path)]
        assert job.updates > 0


def test_a_finished_job_is_not_repeated_unless_its_settings_change(tmp_path: Path) -> None:
    job = Job(name="summary", words=("summarize", "--help"))
    with reproduce.alone(tmp_path) as lock:
        run_job(job, Record(tmp_path), lock)
    record = Record(tmp_path)
    assert record.is_finished(job) and record.jobs["summary"]["seconds"] > 0
    assert not record.is_finished(Job(name="summary", words=("summarize", "elsewhere")))


def test_a_job_that_fails_is_not_finished(tmp_path: Path) -> None:
    job = Job(name="summary", words=("summarize", f"{tmp_path}/nothing"))
    with reproduce.alone(tmp_path) as lock, pytest.raises(ValueError, match="status 1"):
        run_job(job, Record(tmp_path), lock)
    assert not Record(tmp_path).is_finished(job)
