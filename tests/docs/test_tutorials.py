"""What the tutorials show is run, in small: every block of Python of a page, in order."""

import os
import re
from pathlib import Path
from typing import Any

import pytest

from fishrl.envs.stations import SafeArea
from tests.docs.pages import DOCS, count_lines, list_pages, read_blocks
from tests.envs.conftest import SMALL
from tests.envs.test_real_flow import TINY

#: Actions of a few steps.
BRIEF: dict[str, Any] = {"control_interval_T": 0.1, "checks_per_action": 4}
#: A stream with room for nothing but a fish.
CHANNEL: dict[str, Any] = BRIEF | {
    "body_length": 20,
    "reynolds": 300.0,
    "max_wall_speed": 0.15,
    "wall_margin_bl": 0.3,
    "domain_bl": (4.0, 2.4),
    "start_x_bl": (-1.6, -1.4),
    "safe_area": SafeArea(near_bl=-2.0, far_bl=1.0, aside_bl=0.5),
}
SIZES = {"TINY": TINY | BRIEF, "SMALL": SMALL | BRIEF, "CHANNEL": CHANNEL}
WRITTEN = {
    "algorithms.md": ["runs"],
    "tutorials/cylinder.md": ["cylinder.png", "two_cylinders.png"],
    "tutorials/fish_in_a_stream.md": ["fish_in_a_stream.png"],
    "gymnasium.md": ["fish.zip"],
}


@pytest.mark.parametrize("page", list_pages())
def test_the_code_of_a_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__", **SIZES}
    for number, block in enumerate(read_blocks(page)):
        if block.language == "python":
            exec(compile(block.small, f"{page}, block {number}", "exec"), names)
    assert sorted(os.listdir(tmp_path)) == WRITTEN.get(page, [])


def test_a_flow_takes_fifteen_lines_an_environment_ten_and_a_task_sixty() -> None:
    flow, *_ = read_blocks("tutorials/cylinder.md")
    assert count_lines(flow.code) <= 15
    assert {"advance_", "Cylinder"} <= set(flow.code.replace("(", " ").replace(".", " ").split())
    env, *_ = read_blocks("quickstart.md")
    assert count_lines(env.code) <= 10
    task, yaml, *_ = read_blocks("tutorials/new_task.md")
    assert len(task.code.splitlines()) < 60
    assert (task.file, yaml.file) == ("hold_station.py", "conf/task/hold_station.yaml")


def test_the_code_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for block in read_blocks("../README.md"):
        exec(compile(block.small, "README.md", "exec"), {"__name__": "__main__", **SIZES})


def test_every_link_of_readme_and_pages_leads_to_a_file() -> None:
    for page in [*DOCS.rglob("*.md"), DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md"]:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#\s]+)", text):
            is_made = target.endswith("configuration.md")
            assert is_made or "://" in target or (page.parent / target).exists(), (page, target)
