"""Trainings of a gait with flow labels, evaluated and tried in every flow, on fish that glide."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments import export_steering, transfer
from experiments.evaluate import EvaluateConfig, evaluate
from experiments.evaluate import main as evaluate_main
from experiments.gait.trials import load_trial, make_trial
from experiments.train import train
from experiments.train_settings import TRAINING
from fishrl.envs import KarmanGait, Predation
from fishrl.envs.transforms import equip
from fishrl.modules import LateralLineClassifier
from fishrl.training.classifier import keep_recognition, load_recognition
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture
from tests.experiments.gait.tasks import BRIEF, make_task

pytestmark = pytest.mark.usefixtures("gliding")

SETTINGS = [
    "task=karman_gait",
    "preset=gait_small",
    *(f"task.{name}={value}" for name, value in {**SMALL, "wall_margin_bl": 0.25}.items()),
    "task.time_limit=12",
    "compile=false",
    "num_envs=4",
    "total_frames=48",
    "warmup_frames=16",
    "buffer_size=100",
    "batch_size=8",
    "eval_frames=48",
    "eval_episodes=4",
    "final_episodes=4",
    "hidden=[16]",
]


def make_machine(path: Path, task: KarmanGait | None = None) -> str:
    task = task or make_task()
    machine = LateralLineClassifier(
        flows=task.flow_labels,
        sensors=task.lateral_line_layout,
        generator=torch.Generator().manual_seed(0),
    )
    machine.save(path)
    return str(path)


def run(folder: Path, *overrides: str, **settings: object) -> dict[str, Any]:
    config = TRAINING.read([*SETTINGS, f"folder={folder}", *overrides])
    return train(replace(config, **settings))


def read_rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not k.startswith("time/")} for row in rows]


@pytest.mark.parametrize("who", ["machine", "oracle", "nobody"])
def test_a_gait_is_trained_evaluated_and_tried_in_every_flow(tmp_path: Path, who: str) -> None:
    choice = {"machine": make_machine(tmp_path / "m.pt"), "oracle": "oracle", "nobody": None}[who]
    summary = run(tmp_path, "name=run", f"seed={len(who)}", recognition=choice)
    assert summary["success"] == "survived"
    assert summary["baselines"] == ["pid", "random"]
    assert 0.0 < summary["mean_length_T"] <= 6.0
    assert summary["train_diverged"] == 0
    assert (tmp_path / "run" / "learning_curve.png").is_file()
    assert (tmp_path / "run" / "machine.pt").is_file() == (who == "machine")
    trial = load_trial(tmp_path / "run", periods=BRIEF)
    arm = {"machine": "both modules", "oracle": "oracle", "nobody": "true row, unlabelled"}[who]
    assert trial.arm == arm
    results = transfer.transfer(
        [trial, make_trial("pid", trial.task, periods=BRIEF)],
        episodes=2,
        folder=tmp_path / "transfer",
    )
    assert list(results["arms"]) == [arm, "pid"]
    flows = results["arms"][arm]
    assert [flow["episodes"] for flow in flows] == [2, 2, 2]
    share = {"oracle": 1.0}.get(who)
    assert share is None or all(flow["named_right"] == share for flow in flows)
    written = {path.name for path in (tmp_path / "transfer").iterdir()}
    assert {"transfer.md", "transfer.json", "survival.png", "paths.png", "work.png"} <= written
    for file in (tmp_path / "run").rglob("*-actor/*"):
        file.write_bytes(b"other weights")
    assert load_trial(tmp_path / "run", periods=BRIEF).identity != trial.identity


def list_learned(folder: Path) -> dict[str, str]:
    """Return what the last row of a run says of its learning."""
    with (folder / "metrics.csv").open(newline="") as file:
        *_, last = csv.DictReader(file)
    return {name: value for name, value in last.items() if name.startswith(("frames", "train/"))}


def test_a_run_with_a_lateral_line_goes_on_exactly(tmp_path: Path) -> None:
    choice = make_machine(tmp_path / "m.pt")
    whole = run(tmp_path, "name=whole", recognition=choice)
    run(tmp_path, "name=part", "total_frames=24", recognition=choice)
    (tmp_path / "m.pt").unlink()
    (tmp_path / "part").rename(tmp_path / "moved")
    config = TRAINING.read([*SETTINGS, f"folder={tmp_path}"])
    config = replace(config, recognition="machine.pt", resume=str(tmp_path / "moved"))
    resumed = train(config)
    # the shorter run was evaluated at its end too, and the best of all evaluations is what counts
    assert resumed["updates"] == whole["updates"] > 0
    assert list_learned(tmp_path / "moved") == list_learned(tmp_path / "whole")
    assert read_rows(tmp_path / "moved")[-1] == read_rows(tmp_path / "whole")[-1]


def test_an_evaluation_takes_the_machine_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = "task.observes_flow=true"
    run(tmp_path, "name=run", seen, recognition=make_machine(tmp_path / "m.pt"))
    (tmp_path / "m.pt").unlink()
    (tmp_path / "run").rename(tmp_path / "moved")
    saved = tmp_path / "result.json"
    arguments = [f"checkpoint={tmp_path / 'moved'}", "episodes=3", "compile=false", f"save={saved}"]
    monkeypatch.setattr(sys, "argv", ["evaluate", *arguments])
    evaluate_main()
    result = json.loads(saved.read_text())
    assert (result["episodes"], result["task"]) == (3, "KarmanGait")
    config = EvaluateConfig(
        task=TRAINING.read([*SETTINGS, seen]).task,
        preset="x",
        checkpoint=str(tmp_path / "moved"),
        episodes=3,
        compile=False,
    )
    with pytest.raises(ValueError, match="num_inputs = 40, here it is 28"):
        evaluate(config)


def test_recognition_fits_the_task_or_says_why(tmp_path: Path) -> None:
    task = make_task()
    assert equip(task, None) == (task, [])
    assert equip(task, "oracle")[0] == replace(task, reads_flow_class=True)
    with pytest.raises(ValueError, match="Predation has no flows to tell apart"):
        equip(Predation(**SMALL), "oracle")
    for read in (load_recognition, partial(keep_recognition, folder=tmp_path)):
        with pytest.raises(ValueError, match="no such file"):
            read(str(tmp_path / "none.pt"))
    other = make_task(reynolds=400.0)
    with pytest.raises(ValueError, match="reynolds"):
        equip(task, load_recognition(make_machine(tmp_path / "other.pt", other)))


def test_a_policy_of_predation_becomes_a_heading_controller(tmp_path: Path) -> None:
    config = TRAINING.read(["preset=small", f"folder={tmp_path}", "name=run"])
    config.task.update(SMALL)
    few = {"num_envs": 2, "total_frames": 2, "warmup_frames": 2}
    config = replace(config, compile=False, eval_episodes=1, final_episodes=1, **few)
    config = replace(config, picture_episodes=0, baselines=())
    train(config)
    path = tmp_path / "steering.pt"
    steering = export_steering.export_steering(tmp_path / "run", path)
    observations = torch.zeros(3, steering.num_stacked, 4, dtype=torch.float64)
    assert steering.turn(observations).shape == (3,)
    run(tmp_path, "name=gait")
    with pytest.raises(ValueError, match="those of a policy trained on Predation"):
        export_steering.export_steering(tmp_path / "gait", tmp_path / "no.pt")
    assert not (tmp_path / "no.pt").exists()
