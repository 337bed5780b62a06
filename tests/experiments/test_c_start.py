"""The search for the best C-start: what it asks for, what it keeps, and how it goes on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import c_start
from experiments.c_start import CStartSettings, Search, to_numbers, to_strokes
from experiments.validation.c_start import run_strokes
from fishrl.physics import C_START, Strokes

BEST = np.full(8, 0.4)


def swim_toy(strokes: Sequence[Strokes], **_: Any) -> tuple[list[dict[str, Any]], None]:
    """Answer with a distance that falls with that of the numbers from ``BEST``; work is 1."""
    away = [float(np.linalg.norm(to_numbers(each) - BEST)) for each in strokes]
    return [{"distance": 2.0 - r, "work": [0.0, 1.0], "fine": True} for r in away], None


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cmaes", reason="pip install -e '.[sweep]'")
    monkeypatch.setattr(c_start, "run_strokes", swim_toy)


def find(folder: Path, generations: int, **others: Any) -> Search:
    found = Search(CStartSettings(folder=str(folder), generations=generations, **others))
    found.run()
    return found


def test_the_published_strokes_are_among_those_that_are_searched() -> None:
    again = to_strokes(to_numbers(C_START).tolist())
    assert again.phase == pytest.approx(C_START.phase)
    for one, other in zip(again.sequence, C_START.sequence, strict=True):
        assert one.duration == other.duration and one.lag == pytest.approx(other.lag)
        assert one.bend == pytest.approx(other.bend) and one.wave == pytest.approx(other.wave)


@pytest.mark.sweep
@pytest.mark.usefixtures("toy")
def test_an_interrupted_search_goes_on_exactly_and_finds_better_strokes(tmp_path: Path) -> None:
    for folder, parts in (("whole", [12]), ("parts", [5, 12])):
        (tmp_path / folder).mkdir()
        for generations in parts:
            found = find(tmp_path / folder, generations)
    whole, parts = (
        json.loads((tmp_path / folder / "c_start.json").read_text())
        for folder in ("whole", "parts")
    )
    assert whole == parts
    assert found.find_best()[0] > found.found["published"]["distance"] + 0.1
    with pytest.raises(ValueError, match="holds another search"):
        find(tmp_path / "whole", 12, seed=1)


@pytest.mark.sweep
@pytest.mark.usefixtures("toy")
def test_what_other_code_found_is_not_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find(tmp_path, 1)
    monkeypatch.setattr(c_start, "hash_sources", lambda *_: "other code")
    with pytest.raises(ValueError, match="holds another search"):
        find(tmp_path, 2)


@pytest.mark.sweep
@pytest.mark.usefixtures("toy")
def test_more_work_than_published_and_divergence_cost(tmp_path: Path) -> None:
    found = find(tmp_path, 1)
    generation = {
        "distance": [1.0, 1.0, 1.0, 5.0],
        "work": [0.5, 1.0, 1.25, 0.5],
        "fine": [True, True, True, False],
    }
    assert found.rate(generation) == [1.0, 1.0, 0.5, -0.5]


def test_strokes_of_one_batch_swim_as_they_would_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few steps in still water: the work differs between strokes, and not with company."""
    monkeypatch.setattr("experiments.validation.c_start.PARTS", 1)
    other = to_strokes(BEST.tolist())
    given: dict[str, Any] = {"body_length": 16, "tank_bl": 3.0, "steps": 10.0, "compile": False}
    both, _ = run_strokes([C_START, other], **given)
    alone, _ = run_strokes([other], **given)
    assert both[1] == alone[0]
    assert both[0]["work"][-1] > 0.0 and both[0]["work"] != both[1]["work"]
