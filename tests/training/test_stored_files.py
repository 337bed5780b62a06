"""Files of runs that hold anything: refused in one line, or read as settings and results."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from experiments.reproduce import Job, Record
from fishrl.programs.summarize import add_curve_mean, tabulate_groups, tabulate_runs
from fishrl.programs.sweeps.groups import group_runs
from fishrl.programs.sweeps.runs import read_runs
from fishrl.programs.train_settings import TRAINING
from fishrl.training import Plan, load_policy, open_run
from fishrl.training.export import export_policy
from fishrl.training.logger import CsvLogger, read_rows
from fishrl.training.loop import Training
from fishrl.training.plain_files import Tree, read_plain
from fishrl.training.run_folder import read_config
from tests.training.conftest import renew_checksums
from tests.wrong_files import OF_JSON, TEXTS, flip, spoil, try_all

Read = Callable[[Path], object]


def summarize(run: Path) -> None:
    groups = group_runs([add_curve_mean(each) for each in read_runs(run.parent)])
    tabulate_groups(groups)
    tabulate_runs([each for group in groups for each in group.finished])


def resume(run: Path) -> None:
    shutil.copytree(run, run.parents[1] / "copy", dirs_exist_ok=True)
    Training(open_run(run.parents[1] / "copy")).close()


def continue_rows(run: Path) -> None:
    columns = list(read_rows(run / "metrics.csv")[0])
    CsvLogger().open(run.parents[1], columns=columns, config={})
    shutil.copy(run / "metrics.csv", run.parents[1])
    CsvLogger().open(run.parents[1], columns=columns, config={}, step=120)


def export(run: Path) -> None:
    shutil.rmtree(run.parents[1] / "policy", ignore_errors=True)
    export_policy(run, run.parents[1] / "policy")


def read_jobs(run: Path) -> None:
    record = Record(run)
    record.is_finished(Job(name="swimmer", words=("validate",)))
    assert all(job["machine"]["cores"] + job["seconds"] >= 0 for job in record.jobs.values())


#: Files of a run, and what reads each.
READERS: dict[str, tuple[Read, ...]] = {
    "config.yaml": (
        lambda run: Plan.from_config(read_config(run / "config.yaml")),
        lambda run: TRAINING.read([f"resume='{run}'"]),
        summarize,
        resume,
    ),
    "summary.json": (summarize, export),
    "metrics.csv": (summarize, continue_rows),
    "checkpoints/best/manifest.json": (load_policy,),
    "checkpoints/last/manifest.json": (resume,),
    "jobs.json": (read_jobs,),
}


@pytest.fixture
def run(whole: Training, tmp_path: Path) -> Path:
    folder = tmp_path / "sweep" / "run"
    shutil.copytree(whole.folder.path, folder)
    machine = {"cpu": "x", "cores": 2, "gpu": None, "torch": "2"}
    job = {"words": ["validate"], "seconds": 3.0, "is_finished": True, "machine": machine}
    (folder / "jobs.json").write_text(json.dumps({"swimmer": job}))
    return folder


@pytest.mark.parametrize("name", READERS)
def test_wrong_files_of_a_run_are_refused_in_one_line_or_read(run: Path, name: str) -> None:
    file, rng, has_sums = run / name, random.Random(0), name.endswith("manifest.json")
    data = file.read_bytes()

    def read(content: Any) -> None:
        text = content if isinstance(content, bytes) else write(content).encode()
        file.write_bytes(text)
        if has_sums and not isinstance(content, bytes):
            renew_checksums(file.parent)  # as whoever changes it on purpose
        for reader in READERS[name]:
            reader(run)

    def write(tree: Any) -> str:
        text = json.dumps(tree)  # YAML with other words for what JSON lacks
        return text.replace("NaN", ".nan").replace("Infinity", ".inf") if ".y" in name else text

    read(data)
    flipped = try_all((("flip", content) for content in flip(data, rng)), read)
    assert flipped["refused"] and not (has_sums and flipped["read"])
    if file.suffix != ".csv":
        assert try_all(spoil(yaml.safe_load(data), rng), read)["refused"]


@pytest.mark.parametrize("name", ["config.yaml", "summary.json"])
def test_odd_texts_are_refused_at_once(tmp_path: Path, name: str) -> None:
    def read(text: bytes) -> None:
        (tmp_path / name).write_bytes(text)
        read_plain(tmp_path / name, Tree, what="settings")

    texts = (*TEXTS, *(OF_JSON if name == "summary.json" else ()))
    assert not try_all(((str(text[:20]), text) for text in texts), read)["read"]


@pytest.mark.parametrize("key", ["seed", "gamma", "hidden", "task"])
def test_a_run_whose_settings_changed_since_its_checkpoint_is_not_resumed(
    run: Path, key: str
) -> None:
    config = read_config(run / "config.yaml")
    other = {"seed": 5, "gamma": 0.5, "hidden": [8], "task": config["task"] | {"time_limit": 9}}
    (run / "config.yaml").write_text(yaml.safe_dump(config | {key: other[key]}))
    with pytest.raises(ValueError, match=rf"^{key}.*: is .* in .*checkpoints/last; take"):
        open_run(run)
