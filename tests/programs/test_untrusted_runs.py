"""Run folders and checkpoints of others: no program makes or imports what only a file names."""

from __future__ import annotations

import random
import re
import subprocess
import sys
from collections.abc import Callable
from copy import deepcopy
from functools import cache, reduce
from itertools import cycle, product
from pathlib import Path
from typing import Any

import pytest
import torch
from markdown_it import MarkdownIt

from experiments import transfer
from fishrl.children import make_environment
from fishrl.pages import write_table
from fishrl.programs import evaluate, export, export_data, export_policy, train, view
from fishrl.programs.program import Program
from fishrl.programs.summarize import summarize
from fishrl.programs.train_settings import TRAINING, TrainConfig, read_resumed
from fishrl.settings import TARGET, flatten
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import RunFolder, write_yaml

PROGRAMS: dict[str, tuple[Program, tuple[str, ...]]] = {
    "evaluate": (evaluate.main, ("policy={run}", "task.time_limit=3", "flows.compile=false")),
    "view": (view.main, ("policy={run}", "save={run}/x.rrd", "flows.compile=false")),
    "resume": (train.main, ("resume={run}",)),
    "own files": (train.main, ("resume={run}", "--config-dir={run}/..")),
    "train": (train.main, ("task=karman_gait", "folder={run}/..", "name=run")),
    "sweep": (train.main, ("--multirun", "task=karman_gait", "folder={run}/..")),
    "transfer": (transfer.main, ("runs=[{run}]", "baselines=[]", "folder={run}/transfer")),
    "export_policy": (export_policy.main, ("run={run}", "folder={run}/policy")),
    "export": (export.main, ("policy={run}", "save={run}/flow.nc")),
    "export_data": (export_data.main, ("policy={run}", "name=a/b-v0", "folder={run}/data")),
}
KINDS = ("task", "nested", "module", "algorithm", "logger")
WHOLE = ("resume", "own files", "train", "sweep")  # which read all settings of the run
CASES = [
    *product(WHOLE, KINDS),
    *product((name for name in PROGRAMS if name not in WHOLE), ("task", "module")),
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
def test_a_program_refuses_what_a_run_names(
    tmp_path: Path, mark: Path, name: str, kind: str
) -> None:
    main, arguments = PROGRAMS[name]
    run = store(tmp_path, mark, kind)
    with pytest.raises(SystemExit, match=r"_target_: \S+: (is no|module 'planted')"):
        main([argument.format(run=run) for argument in arguments])
    assert not mark.exists()


def test_a_summary_neither_imports_nor_advises_to_import_what_a_run_names(
    tmp_path: Path, mark: Path
) -> None:
    store(tmp_path, mark, "module")
    assert "rerun: " in (text := summarize(tmp_path)) and "planted" not in text
    assert not mark.exists()
    evaluated = ["policy=passive", "modules=[planted]", "task._target_=planted.Task"]
    task = evaluate.main.read(["task=karman_gait", *evaluated]).task
    assert type(task).__name__ == "KarmanGait"
    assert mark.exists()  # named by the user


#: Values that mean something to hydra, a terminal, Markdown and HTML, YAML, or us.
ODD = (
    *("${oc.env:SECRET}", "${seed}", "a\x1b[31m", "b\nc", "\u202ed", "<script>|[x](y)", "```"),
    *({TARGET: "planted.Task"}, {TARGET: "os.system", "command": "touch mark"}, ["${seed}"]),
)


def test_no_setting_of_a_stored_run_is_imported_resolved_or_printed_as_it_is(
    tmp_path: Path, mark: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET", "s3cret")
    plain = compose().to_config()
    for name in ("plain", "run"):
        (tmp_path / name).mkdir()
        write_yaml(tmp_path / name / "config.yaml", plain)
        (tmp_path / name / "failure.txt").write_text("\x1b]0;a\x07 <script>[x](y)")
    for key, value in zip([*flatten(plain)][::2], cycle(ODD), strict=False):
        config = deepcopy(plain)
        *path, last = key.split(".")
        reduce(dict.__getitem__, path, config)[last] = value
        write_yaml(tmp_path / "run" / "config.yaml", config)
        said = [_try(lambda: read_stored(tmp_path / "run")), _try(lambda: summarize(tmp_path))]
        lines = "\n".join(said).split("\n")
        assert all(line.isprintable() and "s3cret" not in line for line in lines)
        text = (tmp_path / "summary.md").read_text()
        page = MarkdownIt("commonmark").enable("table").render(text)
        assert "<script" not in page and "href" not in page
    assert not mark.exists()


def read_stored(run: Path) -> str:
    """Return the stored settings that the user's own words would be compared with."""
    stored = read_resumed({"resume": str(run)})
    made = flatten(TrainConfig.from_config(stored).to_config())
    assert made.items() <= flatten(stored).items()
    return ""


def _try(act: Callable[[], str]) -> str:
    """Return what a call returns, or the message of its error."""
    try:
        return act()
    except ValueError as error:
        return str(error)


def test_a_child_imports_nothing_from_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("rerun", "fishrl", "yaml", "json")
    for name in names:
        (tmp_path / f"{name}.py").write_text("raise SystemExit('planted')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    code = "; ".join(f"import {name}" for name in names)
    for words in (("-c", code), ("-m", "fishrl", "--help"), ("-m", "rerun", "--version")):
        subprocess.run([sys.executable, *words], env=make_environment(), check=True)


def test_words_in_a_table_are_neither_cells_nor_links_nor_html() -> None:
    draw = random.Random(0)
    for _ in range(200):
        word = "".join(draw.choices("ab|<>[]()!\\/&;:`", k=8)).strip()
        page = MarkdownIt("commonmark").enable("table").render(write_table(["x", "y"], [[word, 1]]))
        tags = set(re.findall(r"<(\w+)", page)) - {"code"}
        assert tags == {"table", "thead", "tbody", "tr", "th", "td"}
        assert page.count("<td>") == 2


def test_what_the_user_types_is_resolved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", "x")
    assert TRAINING.read(["folder=${oc.env:SECRET}"]).folder == "x"
