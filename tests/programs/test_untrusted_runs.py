"""Run folders and checkpoints of others: no program makes or imports what only a file names."""

import subprocess
import sys
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.children import make_environment
from fishrl.programs import evaluate, export_policy, train
from fishrl.programs.program import Program
from fishrl.programs.summarize import summarize
from fishrl.programs.train_settings import TRAINING
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import RunFolder, write_yaml

PROGRAMS: dict[str, tuple[Program, tuple[str, ...]]] = {
    "evaluate": (evaluate.main, ("policy={run}", "task.time_limit=3", "flows.compile=false")),
    "resume": (train.main, ("resume={run}",)),
    "own files": (train.main, ("resume={run}", "--config-dir={run}/..")),
    "train": (train.main, ("task=karman_gait", "folder={run}/..", "name=run")),
    "export_policy": (export_policy.main, ("run={run}", "folder={run}/policy")),
}
CASES = [
    *(("resume", kind) for kind in ("task", "nested", "algorithm", "logger")),
    *((name, "module") for name in PROGRAMS),
]


@pytest.fixture
def mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file that is made if the module ``planted`` is imported, or a command runs."""
    mark = tmp_path / "mark"
    (tmp_path / "planted.py").write_text(
        f"import pathlib\npathlib.Path({str(mark)!r}).touch()\n"
        "from fishrl.envs import KarmanGait as Task\n"
        "from fishrl.training.algorithms.discrete_sac import DiscreteSAC as Algorithm\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    return mark


@cache
def compose() -> Any:
    """Return the plan of a run that names our own classes alone."""
    return TRAINING.read(["task=karman_gait"])


def store(folder: Path, mark: Path, kind: str) -> Path:
    """Write a run whose files name a command, or a module, where a class of ours belongs."""
    config = deepcopy(compose().to_config())
    command = f"touch {mark}"
    if kind == "nested":
        config["task"]["stream"] = {"_target_": "subprocess.Popen", "args": command, "shell": True}
    elif kind == "algorithm":
        config["algorithm"] = {"_target_": "planted.Algorithm"}
    elif kind == "module":
        config["task"]["_target_"] = "planted.Task"
    else:
        config[kind] = {"_target_": "os.system", "command": command}
    config["modules"] = ["planted"]  # which a file cannot allow
    run = RunFolder(folder / "run")
    run.best.parent.mkdir(parents=True)
    write_yaml(run.config, config)
    net = {"actor": torch.nn.Linear(1, 1)}
    spec = PolicySpec.for_task(compose().task)
    save_checkpoint(run.best, net, spec=spec, frames=0, config=config)
    return run.path


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_program_refuses_modules_of_a_run(tmp_path: Path, mark: Path, name: str, kind: str) -> None:
    main, arguments = PROGRAMS[name]
    run = store(tmp_path, mark, kind)
    with pytest.raises(SystemExit, match=r"_target_: \S+: (must be a|module 'planted')"):
        main([argument.format(run=run) for argument in arguments])
    assert not mark.exists()


def test_summary_imports_no_module_a_run_names(tmp_path: Path, mark: Path) -> None:
    store(tmp_path, mark, "module")
    assert "rerun: " in (text := summarize(tmp_path)) and "planted" not in text
    assert not mark.exists()
    evaluated = ["policy=passive", "modules=[planted]", "task._target_=planted.Task"]
    task = evaluate.main.read(["task=karman_gait", *evaluated]).task
    assert type(task).__name__ == "KarmanGait"
    assert mark.exists()  # named by the user


def test_settings_of_a_stored_run_are_not_resolved(tmp_path: Path, mark: Path) -> None:
    run = store(tmp_path, mark, "module")
    write_yaml(run / "config.yaml", compose().to_config() | {"preset": "${oc.env:HOME}"})
    assert TRAINING.read([f"resume={run}"]).preset == "${oc.env:HOME}"


def test_child_ignores_its_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "json.py").write_text("raise SystemExit('planted')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    for words in (("-c", "import json"), ("-m", "json.tool", "--help")):
        subprocess.run([sys.executable, *words], env=make_environment(), check=True)


def test_user_interpolations_are_resolved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", "x")
    assert TRAINING.read(["folder=${oc.env:SECRET}"]).folder == "x"
