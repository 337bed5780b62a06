"""Settings of a training: what fixes its result, and what may change when it continues."""

from __future__ import annotations

import pytest
import torch

from fishrl.physics.fast.checks import check_device
from fishrl.settings import list_fields
from fishrl.training.settings import LearningSettings, RunSettings


def test_no_setting_belongs_to_both_classes() -> None:
    learning, run = list_fields(LearningSettings), list_fields(RunSettings)
    assert not {entry.name for entry in learning} & {entry.name for entry in run}


def test_batch_larger_than_the_buffer_is_refused() -> None:
    with pytest.raises(ValueError, match="batch_size"):
        LearningSettings(batch_size=65, buffer_size=64)


@pytest.mark.parametrize("device", ["gpu", "cpu:7", "meta", "cuda:99"])
def test_missing_device_is_refused(device: str) -> None:
    with pytest.raises(ValueError, match=f"device = '{device}'"):
        check_device(device)
    check_device("cpu")
    if torch.cuda.is_available():
        check_device("cuda")
