"""Settings of a training: what fixes its result, and what may change when it continues."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from typing import Any

import pytest
import torch

from fishrl.settings import list_fields
from fishrl.training.settings import LearningSettings, RunSettings, check_device


def test_no_setting_belongs_to_both_classes() -> None:
    learning, run = list_fields(LearningSettings), list_fields(RunSettings)
    assert not {entry.name for entry in learning} & {entry.name for entry in run}


@pytest.mark.parametrize(
    "wrong",
    [
        {"batch_size": 65, "buffer_size": 64},
        {"num_envs": 8, "ray_collectors": 3},
    ],
    ids=str,
)
def test_inconsistent_learning_settings_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        LearningSettings(**wrong)


def test_lists_from_a_file_become_tuples_and_nothing_changes_afterwards() -> None:
    learning = LearningSettings(hidden=[16, 8])  # type: ignore[arg-type]
    assert learning == LearningSettings(hidden=(16, 8))
    assert RunSettings(baselines=["random"]).baselines == ("random",)  # type: ignore[arg-type]
    with pytest.raises(FrozenInstanceError):
        learning.seed = 3  # type: ignore[misc]


@pytest.mark.parametrize("device", ["gpu", "cpu:7", "meta", "cuda:99"])
def test_missing_device_is_refused(device: str) -> None:
    with pytest.raises(ValueError, match=f"device = '{device}'"):
        check_device(device)
    check_device("cpu")
    if torch.cuda.is_available():
        check_device("cuda")
