"""Every program for a few steps, as its command line runs it: ``make smoke``.

Fish that hunt and fish in streams without obstacles swim in a real flow, very small. Those in wakes
glide, as a wake takes minutes to develop; ``tests/envs/test_real_wake.py`` has one that is real.
"""

from __future__ import annotations

import importlib
import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.__main__ import list_programs
from fishrl.benchmark import list_versions
from fishrl.programs.train_settings import TRAINING
from tests.docs.test_tutorials import BRIEF, CHANNEL
from tests.envs.conftest import SMALL, move_kinematically
from tests.envs.test_follower import TINY as FOLLOWER
from tests.envs.test_real_flow import TINY
from tests.process_state import leaving_process_as_it_was
from tests.programs.stage import find_module

pytestmark = pytest.mark.smoke
ROOT = Path(__file__).parents[2]
GROUPS = TRAINING.list_choices()

#: Actions of a few steps, in flows that are hardly larger than the fish.
REAL: dict[str, dict[str, Any]] = {
    "predation": TINY | BRIEF,
    "predation_pair": TINY | BRIEF,
    "follower": FOLLOWER | BRIEF,
    "free_stream": CHANNEL | {"safe_area": "{near_bl:-2.0,far_bl:1.0,aside_bl:0.5}"},
}
KINEMATIC: dict[str, Any] = SMALL | BRIEF | {"wall_margin_bl": 0.25}
#: Eager flows, on the device that ``make test-gpu`` names.
EAGER = ["flows.compile=false", f"flows.device={os.environ.get('SMOKE_DEVICE', 'cpu')}"]
FEW = [
    *(*EAGER, "flows.num_envs=2", "total_frames=4", "warmup_frames=2", "updates_per_frame=1"),
    *("batch_size=2", "hidden=[8]", "log_frames=2", "checkpoint_frames=4", "eval_frames=4"),
    *("eval_episodes=1", "final_episodes=1", "task.time_limit=2"),
]


def set_task(values: dict[str, Any]) -> list[str]:
    return [
        f"task.{name}={list(value) if isinstance(value, tuple) else value}"
        for name, value in values.items()
    ]


def _run(program: str, *arguments: object) -> None:
    """Run a program in this process; it must end well."""
    module = importlib.import_module(find_module(program))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [program, *map(str, arguments)])
        with leaving_process_as_it_was():
            try:
                status = module.main()
            except SystemExit as end:
                status = end.code
    assert status in (None, 0)


def _train(folder: Path, name: str, *arguments: str, pictures: int = 0) -> Path:
    few = [*FEW, f"picture_episodes={pictures}"]
    _run("train", f"folder={folder}", f"name={name}", *few, *arguments)
    assert (folder / name / "summary.json").is_file()
    return folder / name


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def predation_run(runs: Path) -> Path:
    """Train on predation in a real flow, with pictures."""
    task = set_task(REAL["predation"])
    return _train(runs, "predation_run", "task=predation", *task, pictures=1)


@pytest.fixture(scope="module")
def gait_run(runs: Path) -> Path:
    """Train on the Kármán gait with the true flow label; the fish glides."""
    with pytest.MonkeyPatch.context() as patch:
        move_kinematically(patch)
        chosen = ["task=karman_gait", "preset=gait_small", "recognition=oracle"]
        task = [*set_task(KINEMATIC), "task.start_flows=[0,1,2]"]
        return _train(runs, "gait_run", *chosen, *task)


def list_all_programs() -> set[str]:
    """List the programs of fishrl and of ``experiments``."""
    research = {
        path.stem
        for path in (ROOT / "experiments").glob("*.py")
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8")
    }
    return {*list_programs(), *research}


def test_every_program_has_a_smoke_test() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    run = set(re.findall(r'_run\(\s*(?:\*\()?"([\w-]+)"', text))
    missing = list_all_programs() - {"demo"} - run  # the demo runs view
    assert not missing, f"no smoke test runs {sorted(missing)}"


@pytest.mark.parametrize("task", sorted({*GROUPS["task"]} - {"predation", *list_versions()}))
def test_each_task_trains(task: str, runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if task not in REAL:
        move_kinematically(monkeypatch)
    is_continuous = task.endswith("_continuous") or task.startswith("follower")
    more = ["algorithm=sac"] if is_continuous else []
    if task in REAL:
        more += ["baselines=[]"]  # evaluated where fish glide
    if task == "karman_varied":
        more += [f"task.stream.diameter_bl={[0.4, 0.5, 0.6, 0.7] * 3}"]
    _train(runs, task, f"task={task}", *more, *set_task(REAL.get(task, KINEMATIC)))


@pytest.mark.usefixtures("kinematic")
def test_pair_is_viewed_but_not_exported(tmp_path: Path) -> None:
    chosen = ["policy=pursuit", "task=predation_pair", *set_task(KINEMATIC), *EAGER]
    _run("view", *chosen, f"save={tmp_path / 'flow.rrd'}", "periods=1")
    assert (tmp_path / "flow.rrd").is_file()
    with pytest.raises(AssertionError):  # the program says why, and fails
        _run("export-data", *chosen, "name=pair-v0", f"folder={tmp_path}", "episodes=1")


@pytest.mark.usefixtures("kinematic")
@pytest.mark.parametrize("algorithm", ["sac", "ppo"])
def test_continuous_policy_is_trained_and_exported(algorithm: str, tmp_path: Path) -> None:
    chosen = ["task=predation_continuous", f"algorithm={algorithm}", *set_task(KINEMATIC)]
    rollout = ["algorithm.rollout_length=2"] if algorithm == "ppo" else []
    run = _train(tmp_path, algorithm, *chosen, *rollout, pictures=1)
    _run("export-policy", f"run={run}", f"folder={tmp_path / 'policy'}")
    _run("evaluate", f"policy={tmp_path / 'policy'}", "episodes=1", "flows.num_envs=1", *EAGER)


@pytest.mark.usefixtures("kinematic")
def test_policy_is_scored(tmp_path: Path) -> None:
    chosen = ["policy=pursuit", "task=predation-quick-v1", "split=validation"]
    _run("score", *chosen, *EAGER, "flows.num_envs=32", f"save={tmp_path / 'row.json'}")
    assert (tmp_path / "row.json").is_file()


@pytest.mark.xdist_group("predation_run")
def test_learned_policy_is_shown_and_exported(predation_run: Path, tmp_path: Path) -> None:
    few = [f"policy={predation_run}", *EAGER]
    _run("export", *few, f"save={tmp_path / 'flow.nc'}", "periods=1", "frames_per_T=2")
    assert (tmp_path / "flow.nc").stat().st_size > 1000
    data = ["name=catches-v0", f"folder={tmp_path / 'data'}", "episodes=1", "flows.num_envs=1"]
    _run("export-data", *few, *data)
    assert (tmp_path / "data/catches-v0/data/main_data.hdf5").is_file()
    _run("view", *few, f"save={tmp_path / 'flow.rrd'}", "periods=1")
    assert (tmp_path / "flow.rrd").is_file()


@pytest.mark.usefixtures("kinematic")
def test_transfer_writes_its_tables(gait_run: Path, tmp_path: Path) -> None:
    given = [f"runs=[{gait_run}]", "baselines=[pid]", "episodes=1", "periods=0.2"]
    _run("transfer", *given, EAGER[1], f"folder={tmp_path}")
    assert (tmp_path / "transfer.md").is_file()


@pytest.mark.xdist_group("predation_run")
def test_summarize_writes_its_tables(predation_run: Path) -> None:
    _run("summarize", predation_run.parent)
    assert (predation_run.parent / "summary.md").is_file()


@pytest.mark.usefixtures("kinematic")
def test_lateral_line_classifier_is_trained(tmp_path: Path) -> None:
    few = ["num_samples=96", "max_decisions=2", "flows.num_envs=6", "num_epochs=2", "hidden=[8]"]
    places = [f"folder={tmp_path}", "name=line", f"data_folder={tmp_path / 'data'}"]
    _run("train-lateral-line", *few, *places, *set_task(KINEMATIC), *EAGER)
    assert (tmp_path / "line" / "classifier.pt").is_file()


@pytest.mark.slow  # runs every other program in a process of its own
def test_tiny_reproduction_runs_all_jobs_and_writes_its_page(tmp_path: Path) -> None:
    torch.compile(torch.sin)(torch.ones(1))  # sets variables and paths of torch's own, once
    _run("reproduce", "scale=tiny", f"folder={tmp_path}")
    page = (tmp_path / "reproduction.md").read_text(encoding="utf-8")
    pictures = re.findall(r"\]\((figures/\w+\.\w+)\)", page)
    assert len(pictures) == 11 and all((tmp_path / picture).is_file() for picture in pictures)
    assert "| survival with both, T | 100.0, 100.0, 100.0 |" in page


def test_long_training_is_watched(runs: Path) -> None:
    task = set_task(REAL["predation"])
    _run("endurance", f"folder={runs}", "name=long", *FEW, *task, "baselines=[]", "buffer_size=9")
    assert "open_files" in (runs / "long" / "endurance.json").read_text(encoding="utf-8")


def test_validation_case_and_benchmark_run(tmp_path: Path) -> None:
    _run("validate", "quick=true", "cases=[taylor-green]", f"folder={tmp_path}", "jobs=1")
    few = ["groups=[probe]", "body_length=80", "rounds=2", "burst=0.01", "threads=1"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OMP_NUM_THREADS", "1")  # which it sets for the processes that it starts
        _run("benchmark", *few, f"folder={tmp_path}")
