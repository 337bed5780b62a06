"""The program that evaluates: where its result is written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from experiments.evaluate import main


def test_where_a_result_cannot_be_written_is_found_before_anything_swims(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("experiments.evaluate.evaluate", lambda *_, **__: pytest.fail("swam first"))
    with pytest.raises(SystemExit, match=r"error: no folder .*nowhere: make it first"):
        main(["policy=random", f"save={tmp_path / 'nowhere' / 'x.json'}"])
    with pytest.raises(SystemExit, match=r"error: save=.*: cannot be written; choose another"):
        main(["policy=random", f"save={tmp_path}"])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(SystemExit, match=r"error: save=.*: cannot be written; choose another"):
        main(["policy=random", f"save={tmp_path / 'x.json'}"])


def test_a_result_that_cannot_be_written_is_printed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def swim_while_the_folder_goes(*_: Any, **__: Any) -> dict[str, Any]:
        (tmp_path / "gone").rmdir()
        return {"mean_return": 1.5}

    (tmp_path / "gone").mkdir()
    monkeypatch.setattr("experiments.evaluate.evaluate", swim_while_the_folder_goes)
    with pytest.raises(SystemExit, match=r"error: .*No such file.*gone"):
        main(["policy=random", f"save={tmp_path / 'gone' / 'x.json'}"])
    assert "mean_return             1.500" in capsys.readouterr().out
