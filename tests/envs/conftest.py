"""Small tasks, with and without a flow."""

from typing import Any

import pytest

import fishrl.envs.task
from fishrl.envs import Predation
from tests.envs.gliding import GlidingSolver

#: Smallest scales that the units and the wall margin allow without much delay; not honest physics.
SMALL: dict[str, Any] = {
    "body_length": 20,
    "reynolds": 500.0,
    "max_wall_speed": 0.15,
    "wall_margin_bl": 0.15,
}


@pytest.fixture
def gliding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the flow by fish that glide."""
    monkeypatch.setattr(fishrl.envs.task, "InPlaceSolver", GlidingSolver)


@pytest.fixture
def small_task() -> Predation:
    return Predation(**SMALL)
