"""The stages of a reproduction: valid commands, each run once."""

import os
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

from experiments import paper, reproduce
from experiments.reproduce import Record, Stage, list_stages, run_stage
from fishrl.__main__ import list_programs
from fishrl.physics import ImmersedBoundary
from fishrl.programs.sweeps.jobs import plan_jobs
from fishrl.training.run_folder import write_json
from tests.training.conftest import make_run_folder


def mark(scale: str) -> object:
    """Return a scale, slow unless it is the smallest or the paper's: only numbers differ."""
    return scale if scale in ("tiny", "paper") else pytest.param(scale, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    "name", [mark(scale) for scale in reproduce.main.command_line.list_choices()["scale"]]
)
def test_stages_of_scale_are_valid_commands(name: str, tmp_path: Path) -> None:
    scale = replace(reproduce.main.read([f"scale={name}"]).scale, seeds=(0,))
    stages = list(list_stages(scale, tmp_path))
    assert len({stage.name for stage in stages}) == len(stages)
    for stage in stages:
        program, *words = stage.words
        if words[0] == "--multirun":
            (plan,) = [planned.settings for planned in plan_jobs(words[1:])[1]]
        else:
            package = "fishrl.programs" if program in list_programs() else "experiments"
            plan = import_module(f"{package}.{program.replace('-', '_')}").main.read(words)
        if program in ("train", "train-lateral-line"):  # the method of the paper
            assert plan.task.skin == ImmersedBoundary()


def begin(words: Sequence[str]) -> Path:
    """Make the folder of the only run of a sweep."""
    (stage,) = plan_jobs(words)[1]
    return make_run_folder(stage.settings).path


def test_stages_use_results_of_earlier_jobs(tmp_path: Path) -> None:
    for number, name in enumerate(("classifier-10", "classifier-2", "classifier")):
        (tmp_path / name).mkdir()
        if name != "classifier":  # whose fit is not finished
            (tmp_path / name / "lateral_line.json").touch()
            os.utime(tmp_path / name / "lateral_line.json", (number, number))
    assert paper.find_fitted(tmp_path) == tmp_path / "classifier-2"
    scale = reproduce.main.read(["scale=tiny"]).scale
    ablation = next(stage for stage in list_stages(scale, tmp_path) if stage.name == "ablation")
    record = Record(tmp_path)
    record.note(ablation, seconds=1.0, is_finished=True)
    assert not record.is_finished(ablation)  # its run is missing
    run = begin(ablation.words[2:])
    assert not record.is_finished(ablation)
    write_json(run / "summary.json", {"frames": 16})
    assert record.is_finished(ablation)
    words = {stage.name: stage.words for stage in list_stages(scale, tmp_path)}
    assert f"runs=[{run}]" in words["transfer"]
    assert f"recognition.path={tmp_path / 'classifier-2' / 'classifier.pt'}" in words["both"]


def test_finished_stage_is_repeated_only_if_settings_change(tmp_path: Path) -> None:
    stage = Stage(name="summary", words=("benchmarks.machine",))  # a module without a program
    with reproduce.alone(tmp_path) as lock:
        run_stage(stage, Record(tmp_path), lock)
        failing = Stage(name="failing", words=("nothing",))
        with pytest.raises(ValueError, match="status 1"):
            run_stage(failing, Record(tmp_path), lock)
    record = Record(tmp_path)
    assert record.is_finished(stage) and record.stages["summary"].seconds > 0
    assert not record.is_finished(replace(stage, words=(*stage.words, "elsewhere")))
    assert not record.is_finished(failing)
