"""Whether pictures can be drawn here is known without drawing one."""

from pathlib import Path

import pytest

from tests.viewer.pictures import list_drivers


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.delenv(name, raising=False)
    for name in ("one.json", "two.json", "readme.txt"):
        (tmp_path / name).touch()
    return tmp_path


def test_drivers_are_found_where_the_loader_looks(folder: Path) -> None:
    drivers = list_drivers([str(folder / "nowhere"), str(folder)])
    assert {file.name for file in drivers} == {"one.json", "two.json"}
    assert list_drivers([str(folder / "nowhere")]) == []


@pytest.mark.parametrize("variable", ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"])
def test_a_variable_stands_for_the_folders(
    folder: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    monkeypatch.setenv(variable, f"{folder / 'nowhere.json'}:{folder / 'two.json'}")
    assert list_drivers([str(folder)]) == [folder / "two.json"]
    monkeypatch.setenv(variable, "/nonexistent")
    assert list_drivers([str(folder)]) == []
