"""Files of a run: whole or not there, its folder written by one process."""

from __future__ import annotations

from pathlib import Path

import pytest

from fishrl.training.run_folder import (
    RunFolder,
    read_config,
    write_whole,
    write_yaml,
)
from tests.training.conftest import limited_disk


def test_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_whole(tmp_path / "a", "before")
    with limited_disk(3), pytest.raises(OSError, match="File too large"):
        write_whole(tmp_path / "a", "afterwards")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "before")]


@pytest.mark.parametrize("name", ["../run", "a/b", "/run", ".."])
def test_run_name_cannot_escape_the_parent_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="is the name of a folder"):
        RunFolder.create(parent=str(tmp_path / "runs"), name=name)
    assert not list(tmp_path.iterdir())


def test_settings_round_trip_through_yaml(tmp_path: Path) -> None:
    settings = {
        "rate": 1e-05,
        "name": "1e3",
        "on": "yes",
        "none": None,
        "list": [1, 2.0],
        "π": {"a": -0.0},
    }
    write_yaml(tmp_path / "config.yaml", settings)
    assert read_config(tmp_path / "config.yaml") == settings
