"""What a program says of itself: its help, and the commands that it advises."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.command_line import read_arguments, show_command
from experiments.settings import ConfigError
from experiments.train import report
from experiments.usage import describe_program

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("program", "groups"),
    [
        ("train", {"algorithm", "logger", "preset", "task"}),
        ("evaluate", {"preset", "task"}),
        ("view", {"preset", "task"}),
        ("train_lateral_line", {"preset", "task"}),
    ],
)
def test_help_lists_what_the_program_takes_and_where_more_is_said(
    program: str, groups: set[str]
) -> None:
    text = describe_program(program, ["preset=gait_small"])
    assert (
        set(
            re.findall(
                r"^  (\w+): .*, .*$", text.split("chooses:\n")[1].split("\n\n")[0], re.MULTILINE
            )
        )
        == groups
    )
    assert "  body_length: 32\n" in text
    assert "  wall_margin_bl: 0.25\n" in text  # a default of the task, which no YAML names
    assert "[1.0, 3.0]" in text
    assert "make docs" in text and "build/docs/configuration.html" in text
    assert "-m pydoc fishrl.envs.tasks.karman_gait.KarmanGait" in text
    assert "-m pydoc experiments.settings." in text
    assert "???" not in text


def test_help_speaks_of_groups_in_a_folder_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "preset").mkdir()
    (tmp_path / "preset" / "mine.yaml").write_text("# @package _global_\npreset: mine\n")
    text = describe_program("train", ["--config-dir", str(tmp_path)])
    assert "gait_small, mine, paper" in text
    with pytest.raises(ConfigError, match="Did you mean 'total_frames'"):
        describe_program("train", ["totl_frames=3"])


def test_help_is_printed_by_every_program(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        read_arguments("evaluate", ["-h", "preset=quick"])
    assert not end.value.code
    said = capsys.readouterr().out
    assert "logger" not in said
    assert "preset: quick" in said
    assert read_arguments("evaluate", ["seed=1", "policy=random"]) == ["seed=1", "policy=random"]
    with pytest.raises(SystemExit, match=r"error: sed=\.\.\.: .*Did you mean 'seed'"):
        read_arguments("evaluate", ["sed=1"])


def test_commands_are_shown_as_they_would_have_to_be_typed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "my clone" / ".venv" / "bin"
    place.mkdir(parents=True)
    for name in ("python", "python3"):
        (place / name).symlink_to(sys.executable)
    monkeypatch.setattr(sys, "executable", str(place / "python3"))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path / "my clone")
    assert show_command("experiments.view", "runs/x") == (
        ".venv/bin/python3 -m experiments.view runs/x"
    )
    monkeypatch.setenv("PATH", f"{place}:{tmp_path}")
    assert show_command("experiments.train", "resume=runs/x") == (
        "python -m experiments.train resume=runs/x"
    )
    monkeypatch.chdir(tmp_path)
    assert show_command("rerun") == "python -m rerun"
    monkeypatch.setenv("PATH", str(Path(sys.executable).resolve().parent))  # another environment
    monkeypatch.chdir(place.parent)
    assert show_command("rerun") == "bin/python3 -m rerun"
    monkeypatch.chdir(ROOT)
    assert show_command("rerun", "a b") == f"'{place / 'python3'}' -m rerun 'a b'"


def test_a_training_says_how_to_look_at_its_fish(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = {"success": "captured", "baselines": [], "episodes": 2, "wall_seconds": 60.0}
    summary |= {"success_rate": 0.5, "mean_return": 1.0, "mean_length_T": 3.0}
    summary |= {"mean_time_to_success_T": float("nan")}
    report(summary, folder=tmp_path)
    look = show_command("experiments.evaluate", f"checkpoint={tmp_path}")
    see = show_command("experiments.view", f"run={tmp_path}")
    assert capsys.readouterr().out.endswith(f"look again: {look}\nsee it swim: {see}\n")
    (tmp_path / "capture.rrd").touch()  # drawn already
    report(summary, folder=tmp_path)
    see = show_command("experiments.view", str(tmp_path))
    assert capsys.readouterr().out.endswith(f"\nsee it swim: {see}\n")


def test_what_help_names_is_there_to_be_read() -> None:
    (word,) = re.findall(r"-m pydoc (fishrl\S+)", describe_program("view"))
    done = subprocess.run(
        [sys.executable, "-m", "pydoc", word],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=True,
        capture_output=True,
        text=True,
    )
    assert "capture_radius_bl: distance from nose to food" in done.stdout
