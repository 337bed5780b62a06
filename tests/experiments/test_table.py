"""Runs side by side."""

import json
import sys
from pathlib import Path

import pytest

from experiments import table

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
