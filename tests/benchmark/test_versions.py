"""Frozen tasks are as they were frozen; their held-out starts are nobody else's."""

import hashlib
import re

import pytest
import torch

from fishrl.benchmark import SPLITS, compare, find_version, identify, list_rows, list_versions
from fishrl.benchmark.versions import read_draws, sum_settings
from fishrl.envs import make_task
from fishrl.presets import list_names
from fishrl.training.baselines import find_baselines


def test_every_frozen_task_has_its_file_and_quick_variant() -> None:
    names = list_versions()
    assert names == [name for name in list_names("task") if re.search(r"-v\d+$", name)]
    for name in names:
        assert "-quick-" in name or name.replace("-v", "-quick-v") in names


@pytest.mark.parametrize("name", list_versions())
def test_settings_and_starts_are_as_frozen(name: str) -> None:
    version = find_version(name)
    assert sum_settings(version.task) == version.settings
    assert {"random", version.controller} <= {*find_baselines(version.task)}
    for split, num in SPLITS.items():
        task, starts = version.hold_out(split)
        assert starts.shape == (num,)
        assert {*compare(task, version.task)} <= {*version.held_out}
    if version.references is not None:  # what the fish senses changes neither flows nor starts
        other = find_version(version.references)
        assert compare(version.task, other.task) == ["observes"]
        for field in ("measure", "controller", "held_out", "starts"):
            assert getattr(version, field) == getattr(other, field)
        assert {row.policy for row in list_rows(name, "test")} >= {"random", version.controller}


def test_held_out_draws_come_from_a_hash_that_no_seed_gives() -> None:
    for split, num in SPLITS.items():
        draws = read_draws(split)
        assert draws.shape == (num, 12)
        for row, column in ((0, 0), (7, 3), (num - 1, 11)):
            digest = hashlib.sha256(f"fishrl {split} {row} {column}".encode()).digest()
            exact = int.from_bytes(digest[:4], "big") / 2**32
            assert draws[row, column] == pytest.approx(exact, abs=1e-6)
    held_out = torch.cat([read_draws(split) for split in SPLITS])
    assert held_out.unique().numel() > 0.99 * held_out.numel()
    for seed in range(200):  # of an evaluation, and of a training's first starts
        drawn = torch.rand(96, 12, generator=torch.Generator().manual_seed(seed)).double()
        assert not torch.isin(drawn[:, :2], held_out[:, :2]).all(1).any()


def test_streams_of_the_test_are_not_those_of_training() -> None:
    version = find_version("streets-v1")
    task, starts = version.hold_out("test")
    assert not {*starts["flow_index"].tolist()} & {*version.task.start_flows}
    assert task.stream == version.task.stream


def test_task_is_known_by_its_settings_but_for_what_a_policy_may_choose() -> None:
    task = make_task("station-v1", num_stacked=16, stream={"wake_folder": "elsewhere"})
    assert identify(task).name == "station-v1"
    held_out, _ = identify(task).hold_out("test", task=task)
    assert (held_out.num_stacked, held_out.stream.wake_folder) == (16, "elsewhere")
    assert held_out.time_limit == 321
    with pytest.raises(ValueError, match=r"differs from station-v1 in safe_area\.aside_bl: leave"):
        identify(make_task("station-v1", safe_area={"aside_bl": 1.3}))
    with pytest.raises(ValueError, match="did you mean 'station-v1'"):
        find_version("station-v")
