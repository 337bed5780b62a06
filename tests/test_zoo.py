"""The policies that come with the package load, fit their tasks, and are what their cards say."""

import hashlib
import shutil
from pathlib import Path

import pytest
import torch

import fishrl.zoo
from fishrl.envs import make_env, run_episodes
from fishrl.training import load_policy
from fishrl.training.evaluation import fixed_starts
from fishrl.training.policies import load_plan
from tests.envs.conftest import move_kinematically

NAMES = fishrl.zoo.list_policies()


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_acts_in_its_task(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    move_kinematically(monkeypatch)
    policy, task = fishrl.zoo.load_policy(name)
    recognition = fishrl.zoo.load_recognition(name)
    env = make_env(task=task, num_envs=1, recognition=recognition, compile=False)
    starts = fixed_starts(env.base_env.task, 1, seed=0)
    assert run_episodes(env, policy, starts, max_decisions=3).lengths.tolist() == [3]
    assert next(policy.parameters()).dtype == torch.float32


@pytest.mark.parametrize("name", NAMES)
def test_its_folder_is_whole_and_small(name: str) -> None:
    folder = fishrl.zoo.find_policy(name)
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        sha256, file = line.split(maxsplit=1)
        assert hashlib.sha256((folder / file).read_bytes()).hexdigest() == sha256
    assert (folder / "metrics.csv").is_file()
    assert "success rate" in (folder / "README.md").read_text()
    assert sum(file.stat().st_size for file in folder.parent.rglob("*") if file.is_file()) < 6e6


def test_a_name_stands_for_a_checkpoint_unless_there_is_a_folder_of_that_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = load_policy(f"zoo/{NAMES[0]}")
    same, _ = fishrl.zoo.load_policy(NAMES[0])
    for one, other in zip(policy.parameters(), same.parameters(), strict=True):
        assert torch.equal(one, other)
    with pytest.raises(ValueError, match=f"did you mean '{NAMES[0]}'"):
        fishrl.zoo.load_policy(NAMES[0] + "x")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(fishrl.zoo.find_policy("follower_small"), "zoo/mine")
    assert load_plan("zoo/mine")[1].preset == "follower_small"
