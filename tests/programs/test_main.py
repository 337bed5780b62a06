"""``fishrl`` itself: the list of programs, and mistakes in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fishrl.__main__ import list_programs

ROOT = Path(__file__).parents[2]


def run(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "fishrl", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def test_fishrl_alone_lists_each_program_with_the_first_line_of_its_docstring() -> None:
    said = run().stdout
    assert {"train", "evaluate", "view", "export-data", "demo"} <= set(list_programs())
    assert {"configuration", "live"}.isdisjoint(list_programs())  # no programs
    for name, line in list_programs().items():
        assert name in said
        assert line.replace("``", "`") in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["trian", "seed=0"], "there is no program 'trian'; did you mean 'train'?"),
        (["train", "totl_frames=3"], "there is no 'totl_frames'; did you mean 'total_frames'?"),
    ],
)
def test_a_mistake_ends_a_program_with_one_line(words: list[str], said: str) -> None:
    done = run(*words)
    assert (done.returncode, done.stderr) == (1, f"error: {said}\n")
