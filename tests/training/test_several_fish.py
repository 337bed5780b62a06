"""Several fish in each flow learn one policy in the loop of all other tasks."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.envs import Flows, PredationPair
from fishrl.training import Algorithm, DiscreteSAC, Plan, Training, evaluate, open_run
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from tests.envs.conftest import SMALL
from tests.training.conftest import QUICK, assert_equal_weights, make_toy_plan, read_rows

pytestmark = pytest.mark.usefixtures("kinematic")


def make_plan(folder: Path, *, algorithm: Algorithm, **changes: Any) -> Plan:
    few = {
        "flows": Flows(num_envs=3, compile=False),
        "warmup_frames": 6,
        "updates_per_frame": 0.5,
        "batch_size": 4,
    }
    few |= {"total_frames": 24, "log_frames": 12, "checkpoint_frames": 6, "eval_frames": 24}
    given = QUICK | few | {"name": "pair", "baselines": ("random",)} | changes
    plan = make_toy_plan(folder, algorithm=algorithm, **given)
    task = PredationPair(**SMALL, time_limit=4, control_interval_T=0.25, checks_per_action=6)
    return replace(plan, task=task)


@pytest.mark.parametrize("algorithm", [DiscreteSAC(), PPO(rollout_length=4, num_epochs=2)])
def test_buffer_holds_the_transitions_of_each_fish(tmp_path: Path, algorithm: Algorithm) -> None:
    training = Training(open_run(make_plan(tmp_path, algorithm=algorithm)))
    is_ppo = isinstance(algorithm, PPO)
    summary = training.run()
    num_flows = 12 if is_ppo else 24
    assert len(training.learner.buffer) == 2 * num_flows
    stored = training.learner.buffer[:]["observation_stack"]
    assert stored.shape == (2 * num_flows, 4 * 8)
    # the two fish of a flow see each other from opposite sides
    other = stored[:, -8:-6].reshape(*((3, 2, 4) if is_ppo else (8, 3, 2)), 2)
    one, two = other.unbind(1 if is_ppo else 2)
    torch.testing.assert_close(one, -two)
    assert training.counters.updates == (24 if is_ppo else 18)
    names = {"caught_0_rate", "caught_1_rate", "contact_rate", "random_contact_rate"}
    assert names <= summary.keys()
    assert "eval/contact_rate" in read_rows(tmp_path / "pair")[0]
    training.close()
    again = evaluate(tmp_path / "pair", episodes=2, flows=Flows(compile=False))
    assert again["mean_return"] == summary["mean_return"]


def test_epsilon_decays_per_env_frame_not_per_fish(tmp_path: Path) -> None:
    algorithm = DQN(epsilon_start=1.0, epsilon_end=0.1, epsilon_frames=36)
    training = Training(open_run(make_plan(tmp_path, algorithm=algorithm)))
    chance: Any = training.learner.explorer.policy[-1]  # type: ignore[index]
    before = float(chance.eps)
    training.run()
    assert before - float(chance.eps) == pytest.approx(0.9 * (24 - 6) / 36)
    training.close()


def test_run_with_several_fish_resumes_exactly(tmp_path: Path) -> None:
    given: dict[str, Any] = {"algorithm": PPO(rollout_length=4, num_epochs=1)}
    given |= {"scale_inputs": True, "actor_average": 12}
    whole = Training(open_run(make_plan(tmp_path, **given)))
    whole.run()
    begun = Training(open_run(make_plan(tmp_path, **given, name="parts", total_frames=18)))
    begun.run()
    begun.close()
    resumed = Training(open_run(tmp_path / "parts", total_frames=24))
    resumed.run()
    assert_equal_weights(resumed, whole)
    assert read_rows(tmp_path / "parts")[-1] == read_rows(tmp_path / "pair")[-1]
    for training in (whole, resumed):
        training.close()


def test_recurrent_policy_of_several_fish_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="the discrete actions of several fish"):
        make_plan(tmp_path, algorithm=DRQN(sequence_length=4))
