"""The policies that come with the package load, fit their tasks, and are what their cards say."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from fishrl.envs import Flows, make_env, run_episodes
from fishrl.envs.agents import average_fish
from fishrl.programs import evaluate
from fishrl.training import load_plan, load_policy
from fishrl.training.evaluation import fixed_starts
from fishrl.training.export import describe_conditions
from fishrl.zoo import find_policy, list_policies
from tests.envs.conftest import move_kinematically

NAMES = list_policies()


#: Reward and place (x, y in L) of the nose after each decision, of fish that move kinematically;
#: written at e28df4c1, before the order of the discrete bends changed.
TRAJECTORIES = json.loads(Path(__file__).with_name("zoo_trajectories.json").read_text())


@pytest.mark.parametrize("name", NAMES)
def test_policy_keeps_its_trajectory(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    move_kinematically(monkeypatch)
    policy, plan = load_policy(f"zoo/{name}"), load_plan(f"zoo/{name}")
    env = make_env(
        task=plan.task, recognition=plan.recognition, flows=Flows(num_envs=2, compile=False)
    )
    base = env.base_env
    starts = fixed_starts(base.task, 2, seed=0)
    trajectory: list[list[float]] = []

    def keep(_: torch.Tensor, step: TensorDict) -> None:
        places = base.solver.markers()[:, 0] / base.task.body_length
        rewards = average_fish(step["next"], "reward")
        trajectory.extend(torch.cat((rewards, places), 1).tolist())

    run_episodes(env, policy, starts, max_decisions=4, on_step=keep)
    # 1e-5: float32 sums may be ordered differently on another processor
    for row, expected in zip(trajectory, TRAJECTORIES[name], strict=True):
        assert row == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_its_folder_is_whole_and_small(name: str) -> None:
    folder = find_policy(name)
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        sha256, file = line.split(maxsplit=1)
        assert hashlib.sha256((folder / file).read_bytes()).hexdigest() == sha256
    assert (folder / "metrics.csv").is_file()
    card = (folder / "README.md").read_text()
    assert "success rate" in card
    for key, words in describe_conditions(load_plan(folder).task).items():
        assert f"- {key}: {words}\n" in card
    assert sum(file.stat().st_size for file in folder.parent.rglob("*") if file.is_file()) < 7e6


@pytest.mark.parametrize("name", NAMES)
def test_policy_from_before_levels_keeps_its_grid(name: str) -> None:
    manifest = json.loads((find_policy(name) / "manifest.json").read_text())
    stored = {"levels": 1, **manifest["metadata"]["config"]["task"]}
    for task in (load_plan(name).task, evaluate.main.read([f"policy=zoo/{name}"]).task):
        assert (task.body_length, task.levels) == (stored["body_length"], stored["levels"])


def test_zoo_gives_way_to_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=f"did you mean '{NAMES[0]}'"):
        load_policy(f"zoo/{NAMES[0]}x")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(find_policy("follower_small"), "zoo/mine")
    assert load_plan("zoo/mine").preset == load_plan("follower_small").preset == "follower_small"
