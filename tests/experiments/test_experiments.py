"""The sweeps of the pages as ``experiment=<name>``."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from fishrl.programs.sweeps.jobs import Job, plan_jobs

CONF = Path(__file__).parents[2] / "experiments" / "conf"
NAMES = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))


@cache
def plan(name: str) -> list[Job]:
    return plan_jobs(["--config-dir", str(CONF), f"experiment={name}"])


@pytest.mark.parametrize("name", NAMES)
def test_each_experiment_is_a_sweep_of_runs_that_can_be_set_up(name: str) -> None:
    jobs = plan(name)
    folders = {job.path.parent for job in jobs}
    assert len(jobs) > 2 and len({job.path for job in jobs}) == len(jobs)
    assert len(folders) == 1 and folders != {Path("runs")}
    for settings in {str(job.settings.algorithm): job.settings for job in jobs}.values():
        settings.task.flow_config()  # refuses what cannot be simulated


def test_experiments_write_into_different_folders() -> None:
    assert len({plan(name)[0].path.parent for name in NAMES}) == len(NAMES)
