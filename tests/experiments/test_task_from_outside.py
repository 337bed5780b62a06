"""A task of a user's own, in a folder of their own: the one of the tutorial, on fish that glide."""

from __future__ import annotations

import json
import sys
from importlib import import_module
from pathlib import Path
from textwrap import dedent

import pytest

from experiments import search, view
from experiments.command_line import plain_errors
from experiments.config import build, check_overrides, load_config
from experiments.evaluate import main as evaluate_main
from experiments.search_path import CONF, list_groups, split_arguments
from experiments.settings import ConfigError
from experiments.train import main as train_main
from fishrl.training.baselines import make_policy
from tests.docs.pages import read_blocks
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture


@pytest.fixture
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the tutorial's two files, on Python's path."""
    for block in read_blocks("tutorials/new_task.md"):
        if block.file:
            path = tmp_path / "my_fish" / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path / "my_fish"))
    monkeypatch.delitem(sys.modules, "hold_station", raising=False)
    return tmp_path / "my_fish"


SETTINGS = [
    "task=hold_station",
    *(f"task.{name}={value}" for name, value in SMALL.items()),
    "task.time_limit=3",
    "compile=false",
    "num_envs=2",
    "total_frames=8",
    "warmup_frames=4",
    "log_frames=4",
    "checkpoint_frames=8",
    "eval_frames=8",
    "eval_episodes=2",
    "final_episodes=2",
    "batch_size=4",
    "hidden=[8]",
]


def test_what_fails_in_a_file_of_ones_own_is_named_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = """
    from pathlib import Path
    from fishrl.envs import Predation
    def observe():
        one, two = 3 * [0.0]
    def read():
        return Path("x.json").read_text()
    def make():
        return Predation(body_length=3)
    """
    (tmp_path / "buggy.py").write_text(dedent(code))
    monkeypatch.syspath_prepend(str(tmp_path))
    buggy = import_module("buggy")
    place = f"({tmp_path / 'buggy.py'}"
    for function, end in ((buggy.observe, ":5, in observe)"), (buggy.read, ":7, in read)")):
        with pytest.raises(SystemExit) as stop, plain_errors():
            function()
        assert str(stop.value).startswith("error: ")
        assert str(stop.value).endswith(place + end)
    with pytest.raises(SystemExit) as stop, plain_errors():
        buggy.make()
    assert "a fish needs at least 16 nodes" in str(stop.value)
    assert place not in str(stop.value)


@pytest.mark.usefixtures("gliding")
def test_a_task_from_outside_is_trained_and_evaluated_without_any_edit(
    outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = tmp_path / "runs"
    folder = ["--config-dir", str(outside / "conf")]
    monkeypatch.setattr(sys, "argv", ["train", *folder, *SETTINGS, f"folder={runs}", "name=mine"])
    train_main()
    summary = json.loads((runs / "mine" / "summary.json").read_text())
    assert summary["frames"] == 8
    assert summary["baselines"] == ["random"]
    assert (runs / "mine" / "learning_curve.png").is_file()
    saved = tmp_path / "result.json"
    chosen = [f"checkpoint={runs / 'mine'}", "episodes=2", "compile=false", f"save={saved}"]
    monkeypatch.setattr(sys, "argv", ["evaluate", *chosen])
    evaluate_main()
    assert json.loads(saved.read_text())["task"] == "HoldStation"


@pytest.mark.parametrize(
    "words",
    [
        ["--config-dir", "{}"],
        ["--config-dir={}"],
        ["-cd", "{}"],
        ["hydra.searchpath=[file://{}]"],
        ["hydra.searchpath=[{}]"],
    ],
)
def test_a_folder_of_configuration_may_be_named_in_any_of_hydras_ways(
    outside: Path, words: list[str]
) -> None:
    folder = [word.format(outside / "conf") for word in words]
    config = load_config("train", [*folder, "task=hold_station", "task.leash_bl=1.25"])
    assert (config.task["_target_"], config.task["leash_bl"]) == (
        "hold_station.HoldStation",
        1.25,
    )
    assert build(config.task).body_length == 50  # of the default preset
    assert check_overrides("train", [*folder, "seed=1"])[-1] == "seed=1"


@pytest.mark.parametrize("words", [["--config-dir", "{}"], ["--config-dir={}"], ["-cd", "{}"]])
def test_viewer_and_search_take_a_folder_of_configuration_too(
    outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    folder = [word.format(outside / "conf") for word in words]
    settings = view.main.read([*folder, "task=hold_station", "policy=random"])
    assert settings.task["_target_"] == "hold_station.HoldStation"
    assert view.main.read([*folder, "a recording.rrd"]).recording == "a recording.rrd"
    plans: list[search.Search] = []
    monkeypatch.setattr(search, "search", lambda plan, **_: plans.append(plan))
    monkeypatch.setattr(search, "report", lambda *_: None)
    line = [str(tmp_path), *folder, "task=hold_station", "--trials", "1", "gamma=interval(0,1)"]
    monkeypatch.setattr(sys, "argv", ["search", *line])
    search.main()
    assert list(plans[0].space()) == ["gamma"]
    assert load_config("train", plans[0].fixed()).task["_target_"] == "hold_station.HoldStation"


def test_a_preset_from_outside_is_found_too(outside: Path) -> None:
    config = load_config("train", [f"--config-dir={outside / 'conf'}", "preset=mine"])
    assert (config.num_envs, config.preset) == (8, "mine")
    assert (config.task["leash_bl"], config.task["time_limit"]) == (1.5, 20)


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("preset", "num_env: 2", "preset/wrong.yaml: there is no 'num_env'. Did you mean 'num_en"),
        ("preset", "num_envs: two", "preset/wrong.yaml: num_envs: Value 'two' of type 'str'"),
        ("preset", "num_envs: [", "wrong.yaml"),
        (
            "preset",
            "task: {bodylength: 20}",
            "no 'task.bodylength' in Predation. Did you mean 'task.body_length'? It is set",
        ),
        ("task", "body_length: 20", "task: no _target_ says what to make; begin its YAML with"),
        ("task", "", "task: no _target_ says what to make; begin its YAML with"),
        (
            "task",
            "{_target_: fishrl.envs.Predation, reynold: 900}",
            "no 'task.reynold' in Predation. Did you mean 'task.reynolds'? It is set up by "
            "task/wrong.yaml and preset/small.yaml.",
        ),
    ],
)
def test_mistakes_in_files_of_ones_own_are_named(
    outside: Path, file: str, text: str, said: str
) -> None:
    head = "# @package _global_\n" if file == "preset" else ""
    (outside / "conf" / file / "wrong.yaml").write_text(head + text)
    with pytest.raises(ConfigError) as error:
        load_config("train", [f"--config-dir={outside / 'conf'}", f"{file}=wrong"])
    assert said in str(error.value)


def test_a_preset_without_its_first_line_is_told_so(outside: Path) -> None:
    (outside / "conf" / "preset" / "wrong.yaml").write_text("num_envs: 2")
    for program, others in (("train", []), ("evaluate", ["policy=random"])):
        with pytest.raises(ConfigError, match="begins with the line # @package _global_"):
            load_config(program, [f"--config-dir={outside / 'conf'}", "preset=wrong", *others])


def test_typos_are_named_among_what_is_outside_too(outside: Path) -> None:
    folder = f"--config-dir={outside / 'conf'}"
    with pytest.raises(ConfigError, match="Did you mean 'hold_station'"):
        check_overrides("train", [folder, "task=hold_sttion"])
    with pytest.raises(ConfigError, match=r"Did you mean 'task\.leash_bl'"):
        check_overrides("train", [folder, "task=hold_station", "task.leesh_bl=1"])
    with pytest.raises(ConfigError, match=r"task\.leash_bl=far: must be a number"):
        check_overrides("train", [folder, "task=hold_station", "task.leash_bl=far"])


def test_a_module_that_is_not_on_the_path_is_answered_with_what_to_do(
    outside: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p != str(outside)])
    with pytest.raises(ConfigError, match=r"hold_station.*must be on PYTHONPATH"):
        check_overrides("train", [f"--config-dir={outside / 'conf'}", "task=hold_station"])


@pytest.mark.parametrize(
    "words", [["--config-dir", "/nowhere"], ["--config-dir"], ["hydra.searchpath=[/nowhere]"]]
)
def test_a_folder_that_is_not_there_is_an_error(words: list[str]) -> None:
    with pytest.raises(ConfigError, match="there is no such folder; give one that holds"):
        check_overrides("train", words)


@pytest.mark.parametrize("word", ["hydra.searchpath=x", "hydra.searchpath=[x"])
def test_a_search_path_is_a_list(word: str) -> None:
    with pytest.raises(ConfigError, match=r"write hydra\.searchpath="):
        check_overrides("train", [word])


def test_options_keep_their_values_and_groups_are_those_of_the_folders() -> None:
    given = ["--package", "x", "-m", "seed=1", "hydra.verbose=true", "--info"]
    assert split_arguments(given) == (
        ["--package", "x", "-m", "hydra.verbose=true", "--info"],
        ["seed=1"],
    )
    folders = {path.name: path for path in CONF.iterdir() if path.is_dir()}
    expected = {name: sorted(p.stem for p in path.glob("*.yaml")) for name, path in folders.items()}
    assert list_groups() == expected


def test_a_fish_that_hunts_or_holds_is_refused_where_there_is_nothing_to_do(outside: Path) -> None:
    config = load_config("train", [f"--config-dir={outside / 'conf'}", "task=hold_station"])
    task = build(config.task)
    for name in ("intercept", "pid"):
        with pytest.raises(ValueError, match="HoldStation with these settings has random"):
            make_policy(name, task=task, seed=0)
