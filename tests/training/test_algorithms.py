"""Every algorithm through the one training loop: equal effort, legal actions, exact resume."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import torch

from experiments.config import load_config, resumed_settings
from experiments.evaluate import evaluate
from experiments.settings import ConfigError, EvaluateConfig, TrainConfig
from experiments.train import set_up
from fishrl.training.algorithms import DQN, DRQN, DiscreteSAC, build_algorithm
from fishrl.training.checkpoint import read_metadata
from fishrl.training.loop import Training
from fishrl.training.run_folder import write_yaml
from tests.training.test_loop import rows_of
from tests.training.toy_fish import make_toy_env

MakeConfig = Callable[..., TrainConfig]
TOY = {"_target_": "tests.training.toy_fish.ToyPredation"}
DRQN_NODE = {
    "_target_": "fishrl.training.algorithms.DRQN",
    "sequence_length": 4,
    "epsilon_frames": 60,
}
#: Little of what other tests look at.
QUICK: dict[str, Any] = {"baselines": [], "eval_episodes": 2, "final_episodes": 2}
NODES: dict[str, dict[str, Any]] = {
    "dqn": {"_target_": "fishrl.training.algorithms.DQN", "epsilon_frames": 60},
    "double_dqn": {"_target_": "fishrl.training.algorithms.DQN", "is_double": True},
    "drqn": DRQN_NODE,
}


def training_of(config: TrainConfig) -> Training:
    return set_up(config, make_env=make_toy_env)


def test_every_choice_of_an_algorithm_makes_one() -> None:
    labels = {}
    for name in ("discrete_sac", "dqn", "double_dqn", "drqn"):
        config = load_config("train", [f"algorithm={name}"])
        labels[name] = build_algorithm({"algorithm": config.algorithm}).label
    assert labels == {
        "discrete_sac": "",
        "dqn": "dqn",
        "double_dqn": "double_dqn",
        "drqn": "drqn",
    }
    assert isinstance(build_algorithm({}), DiscreteSAC)
    assert DRQN(is_double=True).label == "double_drqn"


def test_own_settings_of_an_algorithm_can_be_set_and_typos_are_named() -> None:
    config = load_config("train", ["algorithm=drqn", "algorithm.sequence_length=16"])
    assert config.algorithm["sequence_length"] == 16
    with pytest.raises(ConfigError, match=r"Did you mean 'algorithm\.target_entropy_weight'"):
        load_config("train", ["target_entropy_weight=0.3"])
    with pytest.raises(ConfigError, match="Did you mean 'drqn'"):
        load_config("train", ["algorithm=drqnn"])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: DiscreteSAC(alpha_init=0.0), "alpha_init = 0.0: must be greater than 0"),
        (lambda: DiscreteSAC(target_entropy_weight=1.1), "target_entropy_weight = 1.1: must lie"),
        (lambda: DQN(epsilon_start=0.1, epsilon_end=0.2), "must lie between 0 and the start"),
        (lambda: DQN(epsilon_frames=0), "epsilon_frames = 0: must be at least 1"),
        (lambda: DRQN(sequence_length=0), "sequence_length = 0: must be at least 1"),
    ],
)
def test_a_setting_that_cannot_be_is_refused(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make()


def test_a_batch_is_whole_stretches(toy_config: MakeConfig) -> None:
    with pytest.raises(ConfigError, match=r"batch_size = 66: must be a multiple of .* = 4"):
        training_of(toy_config(algorithm=DRQN_NODE, batch_size=66))


@pytest.mark.parametrize("name", NODES)
def test_every_algorithm_goes_on_exactly_with_equal_effort_and_legal_actions(
    toy_config: MakeConfig, tmp_path: Path, name: str
) -> None:
    settings: dict[str, Any] = {
        "task": {"banned_action": 1, "divergence_rate": 0.03},
        "algorithm": NODES[name],
        "buffer_size": 130,  # the oldest are forgotten on the way
        **QUICK,
    }
    whole = training_of(toy_config(name="whole", **settings))
    summary = whole.run()
    # as many as those of SAC in test_training
    assert (summary["frames"], summary["updates"]) == (240, (240 - 80) * 0.25)
    assert summary["train_diverged"] > 0
    assert set(whole.learner.buffer[:]["action"].tolist()) == {0, 2}
    training_of(toy_config(name="part", total_frames=160, **settings)).run()
    resumed = training_of(toy_config(resume=str(tmp_path / "part"), **settings))
    assert resumed.counters.frames == 160
    resumed.run()
    assert rows_of(tmp_path / "part")[-1] == rows_of(tmp_path / "whole")[-1]
    theirs = dict(whole.learner.loss.state_dict())
    for key, value in resumed.learner.loss.state_dict().items():
        assert torch.equal(value, theirs[key]), key
    mine, other = (t.learner.explorer.state_dict() for t in (resumed, whole))
    assert all(torch.equal(value, other[key]) for key, value in mine.items())


def test_stretches_are_pieces_of_one_episode_each(toy_config: MakeConfig) -> None:
    training = training_of(
        toy_config(algorithm=DRQN_NODE, task={"divergence_rate": 0.05}, updates_per_frame=0.0)
    )
    batches = iter(training.collector)
    for _ in range(40):
        training.learner.remember(next(batches).reshape(-1))
    num_short = 0
    for _ in range(20):
        batch = training.learner.buffer.sample().reshape(-1, 4)
        is_real = batch["collector", "mask"]
        steps = batch["step_count"].squeeze(-1)
        traj = batch["collector", "traj_ids"].reshape(steps.shape)
        expected = steps[:, :1] + torch.arange(4)
        assert torch.equal(steps[is_real], expected[is_real])
        assert (traj == traj[:, :1]).all()
        begins = batch["is_init"].squeeze(-1)
        assert torch.equal(begins, steps == 0)
        num_short += int((~is_real).any(-1).sum())
        follows = batch["next", "observation"][:, :-1] == batch["observation"][:, 1:]
        assert follows[is_real[:, 1:]].all()
    assert num_short > 0


def test_memory_rides_along_while_collecting_and_begins_anew_with_each_episode(
    toy_config: MakeConfig,
) -> None:
    training = training_of(toy_config(algorithm=DRQN_NODE, warmup_frames=0, task={"time_limit": 4}))
    batches = iter(training.collector)
    seen = [next(batches)[:, 0].clone() for _ in range(9)]
    for before, after in pairwise(seen):
        begins = after["is_init"].squeeze(-1)
        memory = after["recurrent_state_h"]
        assert (memory[begins] == 0).all()
        assert torch.equal(memory[~begins], before["next", "recurrent_state_h"][~begins])
        assert (memory[~begins] != 0).any(-1).all()


def test_a_fish_with_a_memory_is_evaluated_as_at_the_end_of_its_run(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    training = training_of(
        toy_config(name="run", algorithm=DRQN_NODE, **QUICK | {"final_episodes": 10})
    )
    summary = training.run()
    config = EvaluateConfig(
        task=TOY, preset="toy", checkpoint=str(tmp_path / "run"), episodes=10, compile=False
    )
    result = evaluate(config, make_env=make_toy_env)
    assert result["mean_return"] == summary["mean_return"]
    assert result["success_rate"] == summary["success_rate"]


def test_runs_of_before_there_was_a_choice_are_known(
    toy_config: MakeConfig, tmp_path: Path
) -> None:
    training_of(toy_config(name="run", total_frames=8)).run()
    config = {**read_metadata(tmp_path / "run")[1]["config"]}
    assert config.pop("algorithm") == {"_target_": "fishrl.training.algorithms.DiscreteSAC"}
    config |= {"alpha_init": 0.7, "target_entropy_weight": 0.2}
    write_yaml(tmp_path / "run" / "config.yaml", config)
    settings = resumed_settings(str(tmp_path / "run"), [])
    algorithm = build_algorithm({"algorithm": settings.algorithm})
    assert isinstance(algorithm, DiscreteSAC)
    assert (algorithm.alpha_init, algorithm.target_entropy_weight) == (0.7, 0.2)
    assert not hasattr(settings, "alpha_init")
    with pytest.raises(ConfigError, match="algorithm is fixed in"):
        resumed_settings(str(tmp_path / "run"), ["algorithm=dqn"])
