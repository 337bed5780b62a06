"""Algorithms refuse tasks and settings that do not fit them."""

import pytest

from fishrl.training import Algorithm, DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from tests.training.conftest import Toy


def test_algorithms_have_unique_labels() -> None:
    kinds = (DiscreteSAC(), DQN(), DQN(is_double=True), DRQN(), DRQN(is_double=True), SAC(), PPO())
    labels = ["", "dqn", "double_dqn", "drqn", "double_drqn", "sac", "ppo"]
    assert [algorithm.label for algorithm in kinds] == labels


TAKEN = r"does not learn the {} actions.* one of {}$"


@pytest.mark.parametrize(
    ("algorithm", "is_continuous", "message"),
    [
        (SAC(), False, TAKEN.format("discrete", "discrete_sac, dqn, drqn, ppo")),
        (DiscreteSAC(), True, TAKEN.format("continuous", "ppo, sac")),
        (DRQN(), True, TAKEN.format("continuous", "ppo, sac")),
    ],
)
def test_algorithm_refuses_actions_that_it_does_not_learn(
    toy: Toy, algorithm: Algorithm, is_continuous: bool, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        toy.begin(algorithm=algorithm, task={"is_continuous": is_continuous})


def test_settings_that_do_not_fit_the_algorithm_are_refused(toy: Toy) -> None:
    for algorithm, wrong, said in (
        (PPO(rollout_length=8), {"batch_size": 66}, "66: .* algorithm.rollout_length = 64"),
        (DRQN(sequence_length=4), {"batch_size": 66}, "66: must be a multiple of .* = 4"),
        (DRQN(sequence_length=4), {"hidden": ()}, "needs a hidden layer"),
    ):
        with pytest.raises(ValueError, match=said):
            toy.begin(algorithm=algorithm, **wrong)


def test_ppo_derives_the_settings_that_follow_from_its_rollout(toy: Toy) -> None:
    learning = toy.begin(algorithm=PPO(rollout_length=8), batch_size=32).plan
    assert (learning.warmup_frames, learning.buffer_size) == (0, 64)
    assert learning.updates_per_frame == 10 / 32
