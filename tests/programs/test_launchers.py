"""A sweep through joblib, which runs jobs side by side."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from fishrl.programs.sweeps.runs import read_run
from fishrl.training.checkpoint import Checkpoint
from tests.programs.test_sweep_jobs import HERE, ROOT, SETTINGS

pytestmark = pytest.mark.sweep


@pytest.mark.usefixtures("heeds_ctrl_c")
def test_joblib_runs_save_before_they_are_killed(tmp_path: Path) -> None:
    command = ["-m", "fishrl", "train", "--multirun", "hydra/launcher=joblib", *SETTINGS]
    command += ["hydra.launcher.n_jobs=2", f"folder={tmp_path}", "seed=0,1"]
    command.append(f"logger._target_={HERE}.Lingering")
    sweep = subprocess.Popen(
        [sys.executable, *command],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    marks = [tmp_path / name / "mark" for name in ("seed_0", "seed_1")]
    try:
        while sweep.poll() is None and not all(mark.exists() for mark in marks):
            time.sleep(0.1)
        os.killpg(sweep.pid, signal.SIGINT)  # as Ctrl-C in a terminal, which every process hears
        out, error = sweep.communicate(timeout=600.0)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(sweep.pid, signal.SIGKILL)
    assert sweep.returncode == 1, error
    assert "Traceback" not in error
    assert "interrupted; the same command with the same folder=... continues" in error
    assert "0 of 2 runs finished" in out
    for mark in marks:
        assert (read_run(mark.parent).status, read_run(mark.parent).frames) == ("stopped", 8)
        assert Checkpoint.read(mark.parent / "checkpoints" / "last").frames == 8
        said = (mark.parent / "output.log").read_text(encoding="utf-8")
        assert "SIGINT: saved at frame 8" in said
