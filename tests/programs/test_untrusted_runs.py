"""Run folders and checkpoints of others: no program makes or imports what only a file names."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import asdict
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments import export_steering
from fishrl.envs import AbstractTask
from fishrl.programs import (
    evaluate,
    export,
    export_data,
    export_policy,
    summarize,
    train,
    transfer,
    view,
)
from fishrl.programs.program import Program
from fishrl.programs.sweeps.jobs import find_or_begin
from fishrl.programs.train_settings import TRAINING
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.description import make, to_plain
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import RunFolder, write_yaml

PROGRAMS: dict[str, tuple[Program, tuple[str, ...]]] = {
    "evaluate": (evaluate.main, ("checkpoint={run}", "task.time_limit=3", "compile=false")),
    "view": (view.main, ("run={run}", "save={run}/x.rrd", "compile=false")),
    "train": (train.main, ("resume={run}",)),
    "transfer": (transfer.main, ("runs=[{run}]", "baselines=[]", "folder={run}/transfer")),
    "export_steering": (export_steering.main, ("run={run}", "path={run}/steering.pt")),
    "export_policy": (export_policy.main, ("run={run}", "folder={run}/policy")),
    "export": (export.main, ("checkpoint={run}", "save={run}/flow.nc")),
    "export_data": (export_data.main, ("checkpoint={run}", "name=a/b-v0", "folder={run}/data")),
}
KINDS = ("task", "nested", "module", "algorithm", "logger")
CASES = [
    *product(("train",), KINDS),  # checked as settings of a command line
    *product(("export_steering",), KINDS),  # checked as a stored plan
    *product((n for n in PROGRAMS if n not in ("train", "export_steering")), ("task", "module")),
]


@pytest.fixture
def mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file that is made if the module ``planted`` is imported, or a command runs."""
    mark = tmp_path / "mark"
    (tmp_path / "planted.py").write_text(
        f"import pathlib\npathlib.Path({str(mark)!r}).touch()\n"
        "from fishrl.envs import KarmanGait as Task\n"
        "from fishrl.training import DiscreteSAC as Algorithm\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    return mark


@cache
def compose() -> dict[str, Any]:
    """Return the settings of a run that names our own classes alone."""
    plain: dict[str, Any] = to_plain(asdict(TRAINING.read(["task=karman_gait"])))
    return plain


def store(folder: Path, mark: Path, kind: str) -> Path:
    """Write a run whose files name a command, or a module, where a class of ours belongs."""
    config = deepcopy(compose())
    spec = PolicySpec.for_task(make(config["task"], kind=AbstractTask))
    command = f"touch {mark}"
    if kind == "nested":
        config["task"]["stream"] = {"_target_": "subprocess.Popen", "args": command, "shell": True}
    elif kind == "algorithm":
        config["algorithm"] = {"_target_": "planted.Algorithm"}
    elif kind == "module":
        config["task"]["_target_"] = "planted.Task"
    else:
        config[kind] = {"_target_": "os.system", "command": command}
    run = RunFolder(folder / "run")
    run.best.parent.mkdir(parents=True)
    write_yaml(run.config, config)
    net = {"actor": torch.nn.Linear(1, 1)}
    save_checkpoint(run.best, net, spec=spec, frames=0, config=config)
    return run.path


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_a_program_refuses_what_a_run_names(
    tmp_path: Path, mark: Path, name: str, kind: str
) -> None:
    main, arguments = PROGRAMS[name]
    run = store(tmp_path, mark, kind)
    with pytest.raises(SystemExit, match=r"error: _target_: \S+: (is no|module 'planted')") as end:
        main([argument.format(run=run) for argument in arguments])
    assert "\n" not in str(end.value)
    assert not mark.exists()


def test_sweeps_and_summaries_read_runs_without_making_what_they_name(
    tmp_path: Path, mark: Path
) -> None:
    store(tmp_path, mark, "module")
    assert "modules=[planted]" in summarize.summarize(tmp_path)
    config = TRAINING.read(["task=karman_gait", f"folder={tmp_path}"])
    assert find_or_begin(config, name="run").path.name == "run-2"
    assert not mark.exists()
    evaluated = ["policy=passive", "modules=[planted]", "task._target_=planted.Task"]
    assert evaluate.main.read(["task=karman_gait", *evaluated]).task["_target_"] == "planted.Task"
    assert mark.exists()  # named by the user
