"""Algorithms refuse tasks and settings that do not fit them."""

import pytest

from fishrl.training import Algorithm, DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.algorithms.sac import SAC
from fishrl.training.policy_spec import PolicySpec
from tests.training.conftest import QUICK, Toy


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
    with pytest.raises(ValueError, match="epsilon_end"):
        DQN(epsilon_end=0.2, epsilon_start=0.1)
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


ALGORITHMS = (DiscreteSAC(), DQN(), DRQN(), SAC(), PPO(rollout_length=8))


@pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda algorithm: type(algorithm).__name__)
def test_estimated_memory_is_that_of_a_learner(toy: Toy, algorithm: Algorithm) -> None:
    hidden = (150, 37)
    task = {"is_continuous": isinstance(algorithm, SAC)}
    training = toy.begin(algorithm=algorithm, hidden=hidden, task=task, actor_average=9, **QUICK)
    learner = training.learner
    for batch in training.collector:
        learner.store(batch.reshape(-1))
        if learner.is_ready:
            break
    learner.update()
    training.close()
    weights, targets = list(learner.loss.parameters()), learner.loss.buffers()
    gradients = [weight.grad for weight in weights if weight.grad is not None]
    moments = [moment for state in learner.optimiser.state.values() for moment in state.values()]
    needed = sum(tensor.nbytes for tensor in (*weights, *targets, *gradients, *moments))
    spec, average = training.opened.spec, sum(one.nbytes for one in learner.actor.parameters())
    assert algorithm.count_bytes(spec) == pytest.approx(needed, rel=0.2)
    assert algorithm.count_bytes(spec, has_average=True) - algorithm.count_bytes(spec) == average


def test_networks_of_30_000_units_exceed_24_gib() -> None:
    spec = PolicySpec(task="Predation", num_inputs=12, num_actions=5, hidden=(30_000, 30_000))
    assert DiscreteSAC().count_bytes(spec) > 24 * 2**30
