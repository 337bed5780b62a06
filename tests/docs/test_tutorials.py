"""The Python blocks of README and pages run, reduced; every printed task can be made."""

import ast
import os
import re
from pathlib import Path
from typing import Any

import pytest

from fishrl.envs import AbstractTask, Flows
from fishrl.envs.stations import SafeArea
from fishrl.envs.views import make_scene
from tests.docs.pages import DOCS, PAGES, count_lines, list_pages, read_blocks
from tests.envs.conftest import SMALL, make_streams
from tests.envs.test_real_flow import TINY

#: Actions of a few steps.
BRIEF: dict[str, Any] = {"control_interval_T": 0.25, "checks_per_action": 10}
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
SIZES = {"Flows": Flows, "TINY": TINY | BRIEF, "SMALL": SMALL | BRIEF, "CHANNEL": CHANNEL}
WRITTEN = {
    "../README.md": ["runs"],
    "algorithms.md": ["runs"],
    "tutorials/cylinder.md": ["cylinder.png", "two_cylinders.png"],
    "tutorials/fish_in_a_stream.md": ["fish_in_a_stream.png"],
    "benchmark.md": ["fish.zip"],
    "gymnasium.md": ["films"],
    "tutorials/lateral_line.md": ["classifier.pt"],
}


def make_printed_tasks(code: str, names: dict[str, Any]) -> None:
    """Make and draw each task that a block makes, with the arguments that the reader sees."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            kind = names.get(node.func.id)
            if isinstance(kind, type) and issubclass(kind, AbstractTask):
                make_scene(eval(ast.unparse(node), names))


@pytest.mark.parametrize("page", ["../README.md", *list_pages()])
def test_python_of_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fishrl.envs.wakes.develop_wakes", make_streams)
    names: dict[str, Any] = {"__name__": "__main__", **SIZES}
    for number, block in enumerate(read_blocks(page)):
        if block.language == "python":
            exec(compile(block.small, f"{page}, block {number}", "exec"), names)
            make_printed_tasks(block.code, names)
    assert sorted(os.listdir(tmp_path)) == WRITTEN.get(page, [])


def test_first_examples_stay_short() -> None:
    flow, *_ = read_blocks("tutorials/cylinder.md")
    assert count_lines(flow.code) <= 15
    env, *_ = read_blocks("index.md")
    assert count_lines(env.code) <= 10
    task, _, yaml, *_ = read_blocks("tutorials/new_task.md")
    assert len(task.code.splitlines()) < 60
    assert (task.file, yaml.file) == ("hold_station.py", "conf/task/hold_station.yaml")


LINKED = [*PAGES, *sorted(DOCS.parent.glob("studies/*/README.md"))]


@pytest.mark.parametrize("page", LINKED, ids=lambda page: f"{page.parent.name}/{page.name}")
def test_links_of_page_exist(page: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]*)(?:#([^)]+))?\)", page.read_text(encoding="utf-8"))
    for target, anchor in links:
        path = page.parent / target if target else page
        assert "://" in target or path.exists(), target
        if anchor and path.suffix == ".md" and "://" not in target:
            heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            slugs = [re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads]
            assert anchor in slugs, f"{target}#{anchor}"
