"""Scores between random actions and a controller; stored rows are of the frozen tasks."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from fishrl.benchmark import Row, find_version, list_versions, rank, read_row, show_table
from fishrl.benchmark.versions import FOLDER
from fishrl.training.run_folder import write_json

VERSION = find_version("station-v1")


def make_row(policy: str, value: float, half: float, **changes: Any) -> Row:
    given: dict[str, Any] = {
        "policy": policy, "kind": "baseline", "task": "station-v1", "split": "test",
        "settings": VERSION.settings, "starts": VERSION.starts["test"],
        "measure": VERSION.measure, "value": value, "low": value - half, "high": value + half,
        "metrics": {}, "num_stacked": 4, "num_envs": 16, "recognition": None, "differs": None,
        "trained_decisions": None, "scored_decisions": 10, "cpu_seconds": 1.0, "commit": None,
        "versions": {},
    }  # fmt: skip
    return Row(**given | changes)


def test_score_is_0_for_random_actions_and_1_for_the_controller() -> None:
    mine = make_row("mine", 35.0, 5.0, kind="run")
    rows = [make_row("random", 5.0, 1.0), mine, make_row("tuned_pid", 25.0, 2.0)]
    scores = {row.policy: score for row, score in rank(rows)}
    assert list(scores) == ["mine", "tuned_pid", "random"]
    assert scores["random"] == pytest.approx((0.0, -0.05, 0.05))
    assert scores["tuned_pid"] == pytest.approx((1.0, 0.9, 1.1))
    assert scores["mine"] == pytest.approx((1.5, 1.25, 1.75))
    head, first, *_ = show_table(rows, mark=mine)
    assert "score" in head and first.startswith("> mine") and "1.5 [1.25, 1.75]" in first


def test_table_says_what_sets_a_row_apart_in_columns_that_never_touch() -> None:
    name = "of a name that is longer than any other in the table"
    helped = make_row(name, 9.0, 1.0, recognition="Oracle", differs=["start_flows", "reynolds"])
    head, *lines = show_table([make_row("mine", 8.0, 1.0, differs=[]), helped])
    assert lines[0].endswith("  Oracle, other start_flows, reynolds") and name + "  9" in lines[0]
    assert lines[0].index("Oracle") == head.index("trained with") and lines[1].endswith("–")


def test_no_score_where_the_controller_is_not_well_above_random_actions() -> None:
    rows = [make_row("random", 5.0, 4.0), make_row("tuned_pid", 10.0, 2.0)]
    assert [score for _, score in rank(rows)] == [None, None]
    assert [score for _, score in rank(rows[:1])] == [None]
    named_so = [make_row("random", 5.0, 1.0), make_row("tuned_pid", 25.0, 2.0, kind="function")]
    assert rank(named_so)[0][1] is None


def test_row_of_other_settings_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "row.json"
    row = make_row("mine", 5.0, 1.0)
    write_json(path, row.model_dump())
    assert read_row(path) == row
    for changes, said in (
        ({"starts": "0"}, "not of station-v1 as it is frozen"),
        ({"task": "station-v"}, "did you mean"),
        ({"value": "high"}, "not a result of fishrl score"),
    ):
        write_json(path, row.model_dump() | changes)
        with pytest.raises(ValueError, match=said):
            read_row(path)


def test_stored_rows_are_of_the_frozen_tasks() -> None:
    for path in FOLDER.glob("scores/*/*.json"):
        row = read_row(path)
        assert row.task == path.parent.name in list_versions()
        assert row.split == "test" and row.low <= row.value <= row.high, path
        assert row.trained_decisions is not None, f"{path}: score it with trained=<decisions>"


def test_stored_rows_were_scored_at_commits_that_had_this_version() -> None:
    git = ["git", "-C", str(FOLDER)]
    asked = [*git, "rev-parse", "--is-shallow-repository"]
    if subprocess.run(asked, capture_output=True, text=True).stdout.strip() != "false":
        pytest.skip("needs the whole history")
    frozen = json.loads((FOLDER / "versions.json").read_text())
    for path in FOLDER.glob("scores/*/*.json"):
        row = read_row(path)
        asked = [*git, "merge-base", "--is-ancestor", str(row.commit), "HEAD"]
        assert subprocess.run(asked, capture_output=True).returncode == 0, path
        asked = [*git, "show", f"{row.commit}:./versions.json"]
        then = json.loads(subprocess.run(asked, capture_output=True, text=True).stdout)
        assert then.get(row.task) == frozen[row.task], path
