"""Runs side by side."""

import json
import sys
from pathlib import Path

import pytest

from experiments import table
from experiments.pages import divide
from tests.docs.pages import DOCS

SUMMARY = {
    "success_rate": 0.9375,
    "intercept_success_rate": 1.0,
    "pursuit_success_rate": 0.25,
    "random_success_rate": 0.0,
    "mean_return": 30.25,
    "mean_time_to_success_T": 11.5,
    "frames": 2800,
    "train_diverged": 0,
    "wall_seconds": 600.0,
    "mlups": 512.4,
}


def test_a_finished_run_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY))
    monkeypatch.setattr(sys, "argv", ["table", str(tmp_path)])
    table.main()
    header, rule, row = capsys.readouterr().out.splitlines()
    assert header.count("|") == rule.count("|") == row.count("|")
    assert "93.8% | 100.0% | 25.0% | 0.0% | 30.2 | 11.5 T | 2800 | 0 | 10.0 | 512" in row


def test_a_run_that_is_not_finished_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["table", str(tmp_path)])
    with pytest.raises(SystemExit):
        table.main()
    assert "has no summary.json: give run folders of finished runs" in capsys.readouterr().err


def test_missing_captures_are_a_dash(tmp_path: Path) -> None:
    assert "| - |" in table.make_row("x", SUMMARY | {"mean_time_to_success_T": None})


def test_several_runs_have_a_mean_and_its_interval(tmp_path: Path) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder, rate in zip(folders, (0.8, 0.9), strict=True):
        folder.mkdir()
        (folder / "summary.json").write_text(json.dumps(SUMMARY | {"success_rate": rate}))
    # Student's t of one degree of freedom, 12.71, times 10 / sqrt(2) / sqrt(2)
    assert "Learned, over 2 seeds: 85 ± 64 % (95 % interval)." in table.make_table(folders)


def test_the_page_takes_the_table_and_the_first_runs_pictures(tmp_path: Path) -> None:
    run, page = tmp_path / "run", tmp_path / "docs" / "results.md"
    (tmp_path / "docs" / "figures").mkdir(parents=True)
    page.write_text("before\n<!-- predation: begin -->\nold\n<!-- predation: end -->\nafter\n")
    run.mkdir()
    with pytest.raises(ValueError, match=r"run has no learning_curve.png, .*picture_episodes > 0"):
        table.write_page("new", run, tmp_path / "docs")
    assert "old" in page.read_text()
    for name in table.PICTURES:
        (run / name).write_text(name)
    table.write_page("new", run, tmp_path / "docs")
    assert page.read_text() == (
        "before\n<!-- predation: begin -->\nnew\n<!-- predation: end -->\nafter\n"
    )
    assert (tmp_path / "docs" / "figures" / "capture.gif").read_text() == "capture.gif"


def test_the_page_of_results_has_its_place() -> None:
    divide(DOCS / "results.md", "predation")
