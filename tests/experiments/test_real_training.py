"""A very short training on the real flow: small, eager and not honest physics, but all of it."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
import torch
from PIL import Image

from experiments.settings import TrainConfig
from experiments.train import set_up, train
from fishrl.envs import make_env
from tests.envs.test_real_flow import TINY

pytestmark = pytest.mark.learning


def config_of(folder: Path, **settings: object) -> TrainConfig:
    defaults: dict[str, object] = {
        "task": {"_target_": "fishrl.envs.Predation", **TINY, "time_limit": 2},
        "logger": {"_target_": "experiments.logger.CsvLogger"},
        "preset": "tiny",
        "folder": str(folder),
        "compile": False,
        "num_envs": 2,
        "warmup_frames": 2,
        "log_frames": 2,
        "checkpoint_frames": 4,
        "eval_episodes": 1,
        "final_episodes": 2,
        "baselines": [],
        "picture_episodes": 0,
    }
    return TrainConfig(**{**defaults, **settings})  # type: ignore[arg-type]


def test_a_real_run_goes_on_exactly_from_its_checkpoint(tmp_path: Path) -> None:
    whole = set_up(config_of(tmp_path, name="whole", total_frames=6), make_env=make_env)
    whole.run()
    set_up(config_of(tmp_path, name="part", total_frames=4), make_env=make_env).run()
    resumed = set_up(
        config_of(tmp_path, resume=str(tmp_path / "part"), total_frames=6), make_env=make_env
    )
    assert resumed.counters.frames == 4
    resumed.run()
    expected = dict(whole.learner.loss.state_dict())
    for name, value in resumed.learner.loss.state_dict().items():
        assert torch.equal(value, expected[name]), name
    last_rows = []
    for name in ("whole", "part"):
        with (tmp_path / name / "metrics.csv").open(newline="") as file:
            last_rows.append(list(csv.DictReader(file))[-1])
    for key, value in last_rows[0].items():
        if not key.startswith("time/"):
            assert value == last_rows[1][key], key


def test_a_real_run_ends_with_its_summary_and_pictures(tmp_path: Path) -> None:
    config = config_of(
        tmp_path, name="run", total_frames=2, baselines=["intercept"], picture_episodes=1
    )
    train(config)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["episodes"] == summary["intercept_episodes"] == 2
    assert summary["mlups"] > 0
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert {"learning_curve.png", "trajectories.png", "capture.gif", "capture.rrd"} <= names
    with Image.open(tmp_path / "run" / "trajectories.png") as picture:
        assert min(picture.size) > 200
