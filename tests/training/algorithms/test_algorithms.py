"""Algorithms are frozen settings, checked and written into files like tasks."""

from __future__ import annotations

import dataclasses

import pytest

from fishrl.settings import build, describe
from fishrl.training import Algorithm, DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from tests.training.conftest import Toy

ALL: list[Algorithm] = [
    *(DiscreteSAC(), DQN(), DQN(is_double=True), DRQN(), DRQN(is_double=True)),
    *(SAC(), PPO()),
]


def test_algorithms_have_unique_labels_and_round_trip_through_a_file() -> None:
    assert [algorithm.label for algorithm in ALL] == [
        *("", "dqn", "double_dqn", "drqn", "double_drqn"),
        *("sac", "ppo"),
    ]
    for algorithm in ALL:
        assert build(Algorithm, describe(algorithm)) == algorithm
        with pytest.raises(dataclasses.FrozenInstanceError):
            algorithm.label = "x"  # type: ignore[misc]


def test_rising_epsilon_is_refused() -> None:
    with pytest.raises(ValueError, match="epsilon_end"):
        DQN(epsilon_end=0.2, epsilon_start=0.1)


@pytest.mark.parametrize(
    ("algorithm", "is_continuous", "message"),
    [
        (
            SAC(),
            False,
            "SAC: does not learn the discrete actions.* one of discrete_sac, dqn, drqn, ppo$",
        ),
        (
            DiscreteSAC(),
            True,
            "DiscreteSAC: does not learn the continuous actions.* take one of ppo, sac$",
        ),
        (DRQN(), True, "DRQN: does not learn the continuous actions"),
    ],
)
def test_algorithm_refuses_actions_that_it_does_not_learn(
    toy: Toy, algorithm: Algorithm, is_continuous: bool, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        toy.begin(algorithm=algorithm, task={"is_continuous": is_continuous})


def test_ppo_batch_divides_a_rollout_and_derives_the_other_settings(toy: Toy) -> None:
    with pytest.raises(ValueError, match=r"batch_size = 66: .* algorithm.rollout_length = 64"):
        toy.begin(algorithm=PPO(rollout_length=8), batch_size=66)
    learning = toy.begin(algorithm=PPO(rollout_length=8), batch_size=32).plan.learning
    assert (learning.warmup_frames, learning.buffer_size) == (0, 64)
    assert learning.updates_per_frame == 10 / 32


def test_drqn_batch_is_a_multiple_of_the_sequence_length(toy: Toy) -> None:
    with pytest.raises(ValueError, match=r"batch_size = 66: must be a multiple of .* = 4"):
        toy.begin(algorithm=DRQN(sequence_length=4), batch_size=66)
    with pytest.raises(ValueError, match="needs a hidden layer"):
        toy.begin(algorithm=DRQN(sequence_length=4), hidden=())
