"""Small tasks, with and without a flow."""

from typing import Any

import pytest
import torch

import fishrl.envs.task
from fishrl.envs import Predation
from fishrl.envs.streams import Stream
from fishrl.envs.wakes import WakeBank
from tests.envs.gliding import GlidingSolver

#: Smallest scales that the units and the wall margin allow: fast, not accurate.
SMALL: dict[str, Any] = {
    "body_length": 20,
    "reynolds": 500.0,
    "max_wall_speed": 0.15,
    "wall_margin_bl": 0.15,
}


def glide(patch: pytest.MonkeyPatch) -> None:
    """Replace the flow by fish that glide, and developed wakes by nothing."""
    patch.setattr(fishrl.envs.task, "InPlaceSolver", GlidingSolver)
    bank = WakeBank(populations=torch.zeros(3, 1, 1, 1, 1), shedding_frequencies=torch.ones(3))
    patch.setattr(Stream, "load_wakes", lambda *_: bank)


@pytest.fixture
def gliding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let fish glide."""
    glide(monkeypatch)


@pytest.fixture
def small_task() -> Predation:
    return Predation(**SMALL)
