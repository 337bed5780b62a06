"""A very short training on the real flow: coarse, eager, not physically accurate, but complete."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import pytest
from PIL import Image

from fishrl.programs.train import main
from tests.envs.test_real_flow import TINY

pytestmark = pytest.mark.learning


def run_program(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["train", *arguments])
    main()


def test_the_program_trains_goes_on_and_leaves_summary_and_pictures(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    task = [
        f"task.{name}={list(value) if isinstance(value, tuple) else value}"
        for name, value in {**TINY, "time_limit": 1}.items()
    ]
    folder = tmp_path / "run"
    settings = ["compile=false", "num_envs=2", "warmup_frames=2", "eval_episodes=1"]
    settings += ["final_episodes=2", "baselines=[intercept]", "picture_episodes=0"]
    names = [f"folder={tmp_path}", "name=run", "total_frames=2"]
    run_program(monkeypatch, *task, *settings, *names)
    assert json.loads((folder / "summary.json").read_text())["frames"] == 2
    with caplog.at_level(logging.INFO, logger="fishrl"):
        run_program(monkeypatch, f"resume={folder}", "total_frames=4", "picture_episodes=1")
    assert f"continuing from frame 2 of {folder}" in caplog.text
    said = capsys.readouterr().out
    assert f"fishrl evaluate checkpoint={folder}\n" in said
    assert said.rstrip().endswith(f"fishrl view {folder}")
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["frames"] == 4
    assert summary["episodes"] == summary["intercept_episodes"] == 2
    assert summary["mlups"] > 0
    written = {path.name for path in folder.iterdir()}
    assert {"learning_curve.png", "trajectories.png", "capture.gif", "capture.rrd"} <= written
    with Image.open(folder / "trajectories.png") as picture:
        assert min(picture.size) > 200
