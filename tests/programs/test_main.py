"""``fishrl`` itself: the list of programs, and tab completion as the shell asks for it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fishrl.__main__ import list_programs
from fishrl.programs.completion import answer
from fishrl.programs.train_settings import TRAINING

ROOT = Path(__file__).parents[2]


def run(*words: str, command: str = sys.executable, **env: str) -> subprocess.CompletedProcess[str]:
    words = words if command == "bash" else ("-m", "fishrl", *words)
    env = os.environ | env
    return subprocess.run([command, *words], cwd=ROOT, env=env, capture_output=True, text=True)


def test_fishrl_lists_its_programs() -> None:
    said = run().stdout
    assert {"train", "evaluate", "view", "export-data", "demo"} <= set(list_programs())
    assert {"configuration", "live"}.isdisjoint(list_programs())  # no programs
    for name, line in list_programs().items():
        assert name in said
        assert line.replace("``", "`") in said


def test_misspelt_program_suggests_nearest() -> None:
    done = run("trian", "seed=0")
    said = "error: there is no program 'trian'; did you mean 'train'?\n"
    assert (done.returncode, done.stderr) == (1, said)


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("fishrl eval", ["evaluate"]),
        ("fishrl train task=karman_g", ["karman_gait", "_continuous", "_direct"]),
        ("fishrl train tot", ["total_frames="]),
        ("fishrl train --multirun seed=0,1 alg", ["algorithm=", "algorithm."]),
        ("fishrl train task=karman_gait task.stream.has", ["task.stream.has_disc="]),
        ("fishrl train preset=nix se", []),
    ],
)
def test_shell_completes_programs_choices_and_settings(
    line: str,
    completed: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["fishrl", "-sc", "query=bash"])
    monkeypatch.setenv("COMP_LINE", line)
    answer(list_programs())
    said = capsys.readouterr().out
    words = said.split()
    assert bool(words) == bool(completed)
    assert all(part in said for part in completed)
    assert all(word.startswith(line.split()[-1]) for word in words)


def test_bash_completion(tmp_path: Path) -> None:
    (tmp_path / "fishrl").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m fishrl "$@"\n')
    (tmp_path / "fishrl").chmod(0o700)
    (tmp_path / "conf" / "task").mkdir(parents=True)
    (tmp_path / "conf" / "task" / "predator.yaml").touch()
    line = f"fishrl train --config-dir {tmp_path / 'conf'} task=preda"
    script = f"""
    COMP_WORDBREAKS="="; eval "$(fishrl -sc install=bash)"
    COMP_LINE="{line}" COMP_CWORD=4
    hydra_bash_completion; echo "${{COMPREPLY[@]}}"
    """
    done = run("-c", script, command="bash", PATH=f"{tmp_path}:{os.environ['PATH']}")
    shipped = [name for name in TRAINING.list_choices()["task"] if name.startswith("preda")]
    expected = [f"task={name}" for name in (*shipped, "predator")]
    assert sorted(done.stdout.split()) == sorted(expected) and len(shipped) > 2, done.stderr
