"""The program that evaluates: where its result is written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fishrl.programs.evaluate import main


def test_an_unwritable_result_is_found_before_the_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "fishrl.programs.evaluate.evaluate", lambda *_, **__: pytest.fail("evaluated first")
    )
    with pytest.raises(SystemExit, match=r"error: no folder .*nowhere: make it first"):
        main(["policy=random", f"save={tmp_path / 'nowhere' / 'x.json'}"])
    with pytest.raises(SystemExit, match=r"error: .*: cannot be written; choose another"):
        main(["policy=random", f"save={tmp_path}"])


def test_a_result_that_cannot_be_written_is_still_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def remove_the_folder(*_: Any, **__: Any) -> dict[str, Any]:
        (tmp_path / "gone").rmdir()
        return {"mean_return": 1.5}

    (tmp_path / "gone").mkdir()
    monkeypatch.setattr("fishrl.programs.evaluate.evaluate", remove_the_folder)
    with pytest.raises(SystemExit, match=r"error: .*No such file.*gone"):
        main(["policy=random", f"save={tmp_path / 'gone' / 'x.json'}"])
    assert "mean_return             1.500" in capsys.readouterr().out
