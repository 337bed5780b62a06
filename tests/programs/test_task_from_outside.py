"""A task and an algorithm of a user's own, in a folder of their own, on kinematic fish."""

import json
import re
import shlex
import sys
from pathlib import Path

import pytest

from fishrl.programs import evaluate, train, view
from tests.docs.pages import read_blocks
from tests.envs.conftest import SMALL


@pytest.fixture
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the tutorial's two files, on Python's path."""
    for block in read_blocks("tutorials/new_task.md"):
        if block.file:
            path = tmp_path / "my_fish" / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.code, encoding="utf-8")
    (tmp_path / "my_fish" / "my_learning.py").write_text(
        "from fishrl.training.algorithms.dqn import DQN\nclass MyDQN(DQN): pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path / "my_fish"))
    forget(monkeypatch)
    return tmp_path / "my_fish"


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin as a new process does, without the modules of the user."""
    for name in ("hold_station", "my_learning"):
        monkeypatch.delitem(sys.modules, name, raising=False)


SETTINGS = [
    *("task=hold_station", *(f"task.{name}={value}" for name, value in SMALL.items())),
    *("task.time_limit=3", "flows.compile=false", "flows.num_envs=2"),
    *("total_frames=8", "warmup_frames=4"),
    *("log_frames=4", "checkpoint_frames=8", "eval_frames=8", "eval_episodes=2"),
    *("final_episodes=2", "picture_episodes=0", "batch_size=4", "hidden=[8]"),
]


@pytest.mark.usefixtures("kinematic")
def test_external_task_is_trained_and_evaluated(
    outside: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = tmp_path / "runs" / "mine"
    own = ["algorithm=dqn", "algorithm._target_=my_learning.MyDQN", f"folder={run.parent}"]
    folder = f"--config-dir={outside / 'conf'}"
    train.main([folder, *SETTINGS, *own, "name=mine"])
    summary = json.loads((run / "summary.json").read_text())
    assert (summary["frames"], summary["baselines"]) == (8, ["random"])
    advice = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("evaluate: "))
    saved = tmp_path / "result.json"
    given = [f"policy={run}", "episodes=2", "flows.compile=false", f"save={saved}"]
    trusted = "modules=[hold_station,my_learning]"
    for needed in ([folder], ["modules=[hold_station]"]):  # my_learning is named nowhere
        forget(monkeypatch)
        with pytest.raises(SystemExit, match=r"if you trust it, give modules=\[my_learning\]"):
            evaluate.main([*given, *needed])
    forget(monkeypatch)
    assert trusted in shlex.split(advice)
    evaluate.main([*given, trusted])
    assert json.loads(saved.read_text())["task"] == "HoldStation"
    for needed in ([trusted], ["modules=my_learning", folder]):
        forget(monkeypatch)
        assert type(view.main.read([f"policy={run}", *needed]).task).__name__ == "HoldStation"
        assert "my_learning" in sys.modules
    forget(monkeypatch)
    train.main([f"resume={run}", trusted, "total_frames=12"])
    assert json.loads((run / "summary.json").read_text())["frames"] == 12


def test_every_program_takes_external_task(outside: Path) -> None:
    folder = ["--config-dir", str(outside / "conf")]
    task = train.main.read([*folder, "task=hold_station", "task.leash_bl=1.25"]).task
    assert (type(task).__name__, task.leash_bl, task.body_length) == ("HoldStation", 1.25, 50)
    assert train.main.read([*folder, "task=hold_station"]).modules == ("hold_station",)
    assert train.main.read(folder).modules == ()  # those in use, not all in the folder
    watched = view.main.read([*folder, "task=hold_station", "policy=random"])
    assert type(watched.task) is type(task)


def test_help_and_presets_know_external_tasks(outside: Path) -> None:
    folder = f"--config-dir={outside / 'conf'}"
    said = train.main.describe([folder, "task=hold_station"])
    assert re.search(r"task: one of .*follower, .*hold_station, ", said)
    assert re.search(r"^  task\.leash_bl=\d", said, re.MULTILINE)
    settings = train.main.read([folder, "preset=mine"])
    assert (settings.flows.num_envs, settings.preset) == (8, "mine")
    assert (settings.task.leash_bl, settings.task.time_limit) == (1.5, 20)


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("preset", "# @package _global_\nflows: {num_env: 2}", "did you mean 'flows.num_envs'?"),
        ("preset", "# @package _global_\nflows: [", "wrong.yaml"),
        ("preset", "batch_size: 2", "preset"),
        ("task", "body_length: 20", "task: give a _target_ and its arguments"),
        ("task", "{_target_: fishrl.envs.Predation, reynold: 9}", "did you mean 'task.reynolds'?"),
    ],
)
def test_errors_in_user_yaml_are_named(outside: Path, file: str, text: str, said: str) -> None:
    (outside / "conf" / file / "wrong.yaml").write_text(text)
    with pytest.raises(ValueError, match=re.escape(said)):
        train.main.read([f"--config-dir={outside / 'conf'}", f"{file}=wrong"])


def test_missing_module_names_pythonpath(outside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != str(outside)])
    with pytest.raises(ValueError, match=r"hold_station.*PYTHONPATH"):
        train.main.read([f"--config-dir={outside / 'conf'}", "task=hold_station"])


def test_unknown_task_names_the_folder_setting_after_the_nearest_name() -> None:
    with pytest.raises(ValueError, match=r"did you mean 'station-v1'\? --config-dir <folder>"):
        train.main.read(["task=hold_station"])
