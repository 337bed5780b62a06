"""Sweeps through the launchers beside hydra's own, which the extra `sweep` brings."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.sweeps.runs import read_runs
from tests.experiments.test_sweep_jobs import HERE, SETTINGS, run_program

pytestmark = pytest.mark.sweep


def sweep_two(monkeypatch: pytest.MonkeyPatch, folder: Path, *launcher: str) -> int:
    command = [*SETTINGS, f"folder={folder}", f"logger._target_={HERE}.Gliding", "seed=0,1"]
    return run_program(monkeypatch, "--multirun", *command, *launcher)


def both_finished(folder: Path) -> bool:
    runs = {run.path.name: run.status for run in read_runs(folder)}
    return runs == {"seed_0": "finished", "seed_1": "finished"}


def test_joblib_runs_the_jobs_of_a_sweep_side_by_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="pip install -e '.[sweep]'")
    joblib = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert sweep_two(monkeypatch, tmp_path, *joblib) == 0
    assert both_finished(tmp_path)
    assert "2 of 2 runs finished" in capfd.readouterr().out


def test_submitit_runs_the_jobs_of_a_sweep_on_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher", reason="pip install -e '.[sweep]'")
    submitit = ("hydra/launcher=submitit_local", "hydra.launcher.timeout_min=10")
    assert sweep_two(monkeypatch, tmp_path, *submitit) == 0
    assert both_finished(tmp_path)
    assert "2 of 2 runs finished" in capfd.readouterr().out
    logs = [path for path in (tmp_path / ".submitit").glob("*/*.out") if path.stat().st_size > 0]
    assert len({path.parent for path in logs}) == 2  # one process for each job
