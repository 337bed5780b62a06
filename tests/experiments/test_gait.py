"""Trainings of a gait with flow labels, evaluated and tried in every flow, on kinematic fish."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments import transfer
from experiments.gait.trials import load_trial, make_trial, name_arm
from fishrl.envs import KarmanGait, Oracle
from fishrl.envs.control import DirectFrequencies
from fishrl.modules import LateralLineClassifier
from fishrl.programs.train import RunCallback
from fishrl.programs.train_settings import TRAINING
from fishrl.training import Classifier, complete, open_run
from fishrl.training.callback import SILENT
from fishrl.training.loop import Training
from tests.envs.conftest import move_kinematically
from tests.experiments.gait.tasks import BRIEF, OVERRIDES, make_task
from tests.training.conftest import read_rows

pytestmark = pytest.mark.usefixtures("kinematic")

SETTINGS = [
    *("task=karman_gait", "preset=gait_small", *OVERRIDES, "task.time_limit=12"),
    *("flows.compile=false", "flows.num_envs=4", "total_frames=32", "warmup_frames=8"),
    *("buffer_size=100", "batch_size=8", "hidden=[8]", "picture_episodes=0", "baselines=[random]"),
    *("eval_frames=32", "eval_episodes=2", "final_episodes=2"),
]


def make_classifier(path: Path, task: KarmanGait | None = None) -> Classifier:
    task = task or make_task()
    classifier = LateralLineClassifier(
        flows=task.flow_labels,
        sensors=task.lateral_line_layout,
        generator=torch.Generator().manual_seed(0),
    )
    classifier.save(path)
    return Classifier(path=str(path))


def run(folder: Path, *overrides: str, **settings: object) -> dict[str, Any]:
    words = {word.partition("=")[0]: word for word in (*SETTINGS, *overrides)}
    config = replace(TRAINING.read([*words.values(), f"folder={folder}"]), **settings)
    return complete(Training(open_run(config), callbacks=[RunCallback(config, SILENT)]))


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a run with a classifier, and one with true flow labels."""
    folder = tmp_path_factory.mktemp("runs")
    choice = make_classifier(folder / "m.pt")
    with pytest.MonkeyPatch.context() as patch:
        move_kinematically(patch)
        summary = run(folder, "name=classifier", recognition=choice)
        run(folder, "name=oracle", "seed=1", "baselines=[]", recognition=Oracle())
    assert summary["success"] == "survived"
    assert 0.0 < summary["mean_length_T"] <= 6.0
    return folder


def test_trained_gaits_are_tried_in_every_flow(trained: Path, tmp_path: Path) -> None:
    assert (trained / "classifier" / "classifier.pt").is_file()
    assert not (trained / "oracle" / "classifier.pt").exists()
    trials = [load_trial(trained / name, periods=BRIEF) for name in ("classifier", "oracle")]
    trials.append(make_trial("pid", trials[0].task, periods=BRIEF))
    settings = transfer.TransferSettings(task=make_task(), episodes=2, folder=str(tmp_path))
    results = transfer.transfer(trials, settings)
    arms = results["arms"]
    assert list(arms) == ["both modules", "oracle", "pid"]
    assert [flow["episodes"] for flows in arms.values() for flow in flows] == [2] * 9
    assert all(flow["named_right"] == 1.0 for flow in arms["oracle"])
    written = {path.name for path in tmp_path.iterdir()}
    figures = ("survival", "paths", "decisions", "work")
    assert {"transfer.md", "transfer.json", *(f"{name}.png" for name in figures)} <= written
    assert name_arm(make_task(), None) == "macro-actions alone"
    direct = make_task(control=DirectFrequencies(frequencies=(0.5, 1.0)), observes=("place",))
    assert name_arm(direct, Classifier(path="any")) == "ablation"
    shutil.copytree(trained / "oracle", tmp_path / "oracle")
    for file in (tmp_path / "oracle").rglob("*-actor/*"):
        file.write_bytes(b"other weights")
    assert load_trial(tmp_path / "oracle", periods=BRIEF).identity != trials[1].identity


def list_learned(folder: Path) -> dict[str, str]:
    """Return the frames and training metrics in the last row of a run."""
    *_, last = read_rows(folder)
    return {name: value for name, value in last.items() if name.startswith(("frames", "train/"))}


def test_run_with_classifier_resumes_exactly(trained: Path, tmp_path: Path) -> None:
    choice = make_classifier(tmp_path / "m.pt")
    run(tmp_path, "name=part", "total_frames=20", recognition=choice)
    (tmp_path / "m.pt").unlink()
    (tmp_path / "part").rename(tmp_path / "moved")
    config = TRAINING.read([*SETTINGS, f"folder={tmp_path}"])
    config = replace(
        config, recognition=Classifier(path=str(tmp_path / "moved")), resume=str(tmp_path / "moved")
    )
    resumed = complete(Training(open_run(config), callbacks=[RunCallback(config, SILENT)]))
    # the shorter run was evaluated at its end too, and the best of all evaluations is what counts
    whole = json.loads((trained / "classifier" / "summary.json").read_text())
    assert resumed["updates"] == whole["updates"] > 0
    assert list_learned(tmp_path / "moved") == list_learned(trained / "classifier")
    assert read_rows(tmp_path / "moved")[-1] == read_rows(trained / "classifier")[-1]
