"""Sweeps through the launchers beside hydra's own, which the extra `sweep` brings."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.sweeps.runs import read_runs
from tests.experiments.test_sweep_jobs import HERE, SETTINGS, run_program

pytestmark = pytest.mark.sweep


@pytest.mark.parametrize(
    ("launcher", "settings"),
    [
        ("joblib", ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")),
        ("submitit", ("hydra/launcher=submitit_local", "hydra.launcher.timeout_min=10")),
    ],
)
def test_a_launcher_runs_the_jobs_of_a_sweep(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    launcher: str,
    settings: tuple[str, ...],
) -> None:
    command = [*SETTINGS, f"folder={tmp_path}", f"logger._target_={HERE}.Gliding", "seed=0,1"]
    assert run_program(monkeypatch, "--multirun", *command, *settings) == 0
    runs = {run.path.name: run.status for run in read_runs(tmp_path)}
    assert runs == {"seed_0": "finished", "seed_1": "finished"}
    assert "2 of 2 runs finished" in capfd.readouterr().out
    if launcher == "submitit":  # one process for each job
        logs = [log for log in (tmp_path / ".submitit").glob("*/*.out") if log.stat().st_size > 0]
        assert len({log.parent for log in logs}) == 2
