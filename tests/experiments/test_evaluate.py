"""The program that evaluates: where its result is written."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from experiments.evaluate import check_result, main, write_result


def test_where_a_result_cannot_be_written_is_found_before_anything_swims(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        pytest.fail("swam first")

    monkeypatch.setattr("experiments.evaluate.evaluate", fail)
    for place, said in (
        (tmp_path / "nowhere" / "x.json", "error: no folder .*nowhere: make it first"),
        (tmp_path, "error: save=.*: cannot be written .it is a folder.; choose another file"),
    ):
        monkeypatch.setattr(sys, "argv", ["evaluate", "policy=random", f"save={place}"])
        with pytest.raises(SystemExit, match=said):
            main()
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(ValueError, match=r"cannot be written \(no write permission\)"):
        check_result(str(tmp_path / "x.json"))


def test_a_result_that_cannot_be_written_is_printed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def swim_while_the_folder_goes(*_: Any, **__: Any) -> dict[str, Any]:
        (tmp_path / "gone").rmdir()
        return {"mean_return": 1.5}

    (tmp_path / "gone").mkdir()
    monkeypatch.setattr("experiments.evaluate.evaluate", swim_while_the_folder_goes)
    place = tmp_path / "gone" / "x.json"
    monkeypatch.setattr(sys, "argv", ["evaluate", "policy=random", f"save={place}"])
    with pytest.raises(SystemExit, match=r"error: save=.*: cannot be written \(No such file"):
        main()
    assert "mean_return             1.500" in capsys.readouterr().out


def test_a_result_in_a_folder_without_permission_is_an_error(read_only_folder: Path) -> None:
    with pytest.raises(ValueError, match=r"cannot be written \(Permission denied\); choose"):
        write_result(read_only_folder / "x.json", {})
