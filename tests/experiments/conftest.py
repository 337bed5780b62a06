"""A small training run on the point fish."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from experiments.settings import TrainConfig
from tests.experiments.real_wake import develop

TOY = "tests.experiments.toy_fish.ToyPredation"


@pytest.fixture
def toy_config(tmp_path: Path) -> Callable[..., TrainConfig]:
    def make(*, task: dict[str, Any] | None = None, **settings: Any) -> TrainConfig:
        defaults: dict[str, Any] = {
            "logger": {"_target_": "experiments.logger.CsvLogger"},
            "preset": "toy",
            "folder": str(tmp_path),
            "compile": False,
            "num_envs": 8,
            "total_frames": 240,
            "warmup_frames": 80,
            "updates_per_frame": 0.25,
            "hidden": [16],
            "buffer_size": 1000,
            "log_frames": 40,
            "checkpoint_frames": 80,
            "eval_frames": 120,
            "eval_episodes": 6,
            "final_episodes": 10,
            "picture_episodes": 0,
        }
        return TrainConfig(task={"_target_": TOY, **(task or {})}, **{**defaults, **settings})

    return make


@pytest.fixture(scope="session")
def real_wake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the developed wake of ``real_wake.gait_settings``."""
    folder = tmp_path_factory.mktemp("wakes")
    develop(folder)
    return folder


@pytest.fixture
def read_only_folder() -> Iterator[Path]:
    """A folder that its user may not write; root, who may write anywhere, becomes nobody."""
    folder = Path(tempfile.mkdtemp())
    is_root, nobody = os.geteuid() == 0, 65534
    if is_root:
        os.chown(folder, nobody, nobody)
    folder.chmod(0o500)
    if is_root:
        os.seteuid(nobody)
    yield folder
    if is_root:
        os.seteuid(0)
    folder.rmdir()
