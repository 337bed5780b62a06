"""The benchmark's program."""

import json
from pathlib import Path

import pytest

from experiments import benchmark
from experiments.benchmark import JOBS, choose_jobs, main
from experiments.benchmarks.comparison import Job
from experiments.benchmarks.machine import read_caches
from tests.experiments.benchmarks import toy_jobs


def test_groups_are_chosen_by_name_and_all_by_default() -> None:
    groups = [job.group for job in choose_jobs(main.read(["groups=[coupled,solver]"]).groups)]
    assert groups == ["probe", "solver", "coupled"]
    assert choose_jobs(main.read([]).groups) == list(JOBS)
    with pytest.raises(ValueError, match="did you mean 'coupled'"):
        choose_jobs(["copled"])


@pytest.mark.parametrize(("make", "status"), [("make_pair", 0), ("fail_at_once", 1)])
def test_a_run_prints_tables_keeps_every_time_and_fails_with_a_job(
    make: str, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setenv("TOY_LOG", str(tmp_path / "log"))
    jobs = (
        Job("solver", getattr(toy_jobs, make)),
        Job("compile", toy_jobs.make_number, is_long=True),
    )
    monkeypatch.setattr(benchmark, "JOBS", jobs)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    arguments = [f"folder={tmp_path}", "threads=1", "rounds=2"]
    if status:
        with pytest.raises(SystemExit, match="1"):
            main(arguments)
    else:
        main(arguments)
    assert "| compile, warm | ≤ 1 s | 0.50 s | met |" in capsys.readouterr().out
    kept = json.loads((tmp_path / "results.json").read_text())
    assert {"cpu", "cores", "torch", "versions", "caches", "load"} <= set(kept["machine"])
    assert [row["label"] for row in kept["rows"]][-1] == "compile/warm"
    assert [each["has_failed"] for each in kept["skipped"]] == [True] * status
    assert [len(row["seconds"]) for row in kept["rows"][:-1]] == [2, 2] * (1 - status)


def test_caches_are_read_as_linux_lists_them(tmp_path: Path) -> None:
    for i, (kind, level, size) in enumerate(
        [("Data", "1", "48K"), ("Instruction", "1", "32K"), ("Unified", "3", "32768K")]
    ):
        folder = tmp_path / f"index{i}"
        folder.mkdir()
        for name, value in (("type", kind), ("level", level), ("size", size)):
            (folder / name).write_text(value + "\n")
    assert read_caches(tmp_path) == {"L1": 48 * 1024, "L3": 32 * 2**20}
