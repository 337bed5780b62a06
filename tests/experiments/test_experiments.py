"""The published sweeps, ``experiment=<name>``."""

from pathlib import Path

from fishrl.programs.sweeps.jobs import plan_jobs

CONF = Path(__file__).parents[2] / "experiments" / "conf"


def test_experiments_are_valid_sweeps_in_distinct_folders() -> None:
    folders = []
    for path in sorted((CONF / "experiment").glob("*.yaml")):
        jobs = plan_jobs(["--config-dir", str(CONF), f"experiment={path.stem}", "seed=1"])[1]
        assert len({job.path for job in jobs}) == len(jobs)
        for settings in {str(job.settings.algorithm): job.settings for job in jobs}.values():
            settings.task.flow_config()  # raises ValueError for invalid flows
        folders += {job.path.parent for job in jobs}
    assert len(folders) > 10 and len(set(folders)) == len(folders)
