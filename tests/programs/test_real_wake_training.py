"""A training in a wake that sheds continues exactly after a stop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fishrl.envs import FlowEnv
from fishrl.programs.train import set_up
from fishrl.programs.train_settings import TrainConfig
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.checkpoint import read_metadata
from fishrl.training.logger import CsvLogger
from fishrl.training.loop import Training
from tests.programs.real_wake import develop, make_gait
from tests.training.conftest import assert_equal_weights, read_rows
from tests.training.stops import run_and_stop

pytestmark = pytest.mark.learning

FRAMES = 16


def begin(folder: Path, wakes: Path, **settings: Any) -> Training:
    config = TrainConfig(
        task=make_gait(wakes),
        algorithm=DiscreteSAC(),
        logger=CsvLogger(),
        preset="tiny",
        folder=str(folder),
        compile=False,
        num_envs=2,
        total_frames=FRAMES,
        warmup_frames=4,
        updates_per_frame=1.0,
        batch_size=4,
        buffer_size=8,  # which overflows
        hidden=(16,),
        log_frames=2,
        checkpoint_frames=2,
        eval_frames=8,
        eval_episodes=1,
        picture_episodes=0,
        **settings,
    )
    return set_up(config)


def test_a_training_in_a_real_wake_that_is_interrupted_equals_one_that_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fishrl.training.loop.Training.finish", lambda training: {})
    wakes = tmp_path / "wakes"
    develop(wakes)
    whole = begin(tmp_path, wakes, name="whole")
    whole.run()
    part = begin(tmp_path, wakes, name="part")
    run_and_stop(part, FlowEnv, step=5)
    assert read_metadata(tmp_path / "part", which="last")[1]["frames"] == 10
    assert (part.collector.env.base_env.now["age"] > 0).all()  # amid episodes
    part.close()
    resumed = begin(tmp_path, wakes, resume=str(tmp_path / "part"))
    assert resumed.counters.frames == 10
    resumed.run()
    assert resumed.counters.episodes > 2
    assert read_rows(tmp_path / "part") == read_rows(tmp_path / "whole")
    assert len(read_rows(tmp_path / "part")) == FRAMES // 2
    assert_equal_weights(resumed, whole)
