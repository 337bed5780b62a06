"""Benchmarks of environment and training."""

from experiments.benchmarks.environment import make_overhead, make_training
from experiments.benchmarks.measuring import BenchmarkSettings
from fishrl.envs import Flows, Predation
from fishrl.training.settings import LearningSettings
from tests.envs.test_real_flow import TINY

SETTINGS = BenchmarkSettings()
TASK = Predation(**TINY | {"control_interval_T": 0.2, "checks_per_action": 5})  # few steps


def test_share_of_action_outside_flow_is_measured() -> None:
    env, policy = make_overhead(SETTINGS, task=TASK, flows=Flows(num_envs=2, compile=False))
    for case in (env, policy):
        case.prepare()
        assert 0.0 < case.advance(1)["outside_flow"] < 1.0


def test_share_of_learning_is_measured() -> None:
    learning = LearningSettings(
        flows=Flows(num_envs=2, compile=False), batch_size=2, updates_per_frame=2.0
    )
    gradient, frame = make_training(SETTINGS, task=TASK, learning=learning)
    assert gradient.advance(2) is None
    assert 0.0 < frame.advance(1)["learning"] < 1.0
