"""The policies that come with the package load, fit their tasks, and are what their cards say."""

import hashlib
import shutil
from pathlib import Path

import pytest
import torch

from fishrl.envs import Flows, make_env, run_episodes
from fishrl.training import load_plan, load_policy
from fishrl.training.evaluation import fixed_starts
from fishrl.zoo import find_policy, list_policies
from tests.envs.conftest import move_kinematically

NAMES = list_policies()


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_acts_in_its_task(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    move_kinematically(monkeypatch)
    policy, plan = load_policy(f"zoo/{name}"), load_plan(f"zoo/{name}")
    env = make_env(
        task=plan.task, flows=Flows(num_envs=1, compile=False), recognition=plan.recognition
    )
    starts = fixed_starts(env.base_env.task, 1, seed=0)
    assert run_episodes(env, policy, starts, max_decisions=3).lengths.tolist() == [3]
    assert next(policy.parameters()).dtype == torch.float32


@pytest.mark.parametrize("name", NAMES)
def test_its_folder_is_whole_and_small(name: str) -> None:
    folder = find_policy(name)
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        sha256, file = line.split(maxsplit=1)
        assert hashlib.sha256((folder / file).read_bytes()).hexdigest() == sha256
    assert (folder / "metrics.csv").is_file()
    assert "success rate" in (folder / "README.md").read_text()
    assert sum(file.stat().st_size for file in folder.parent.rglob("*") if file.is_file()) < 6e6


def test_zoo_name_gives_way_to_a_folder_of_that_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValueError, match=f"did you mean '{NAMES[0]}'"):
        load_policy(f"zoo/{NAMES[0]}x")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(find_policy("follower_small"), "zoo/mine")
    assert load_plan("zoo/mine").preset == "follower_small"
