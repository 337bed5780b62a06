"""Networks learn on inputs of unit scale; saved policies read the observations themselves."""

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from fishrl.training import Algorithm
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.ppo import PPO
from fishrl.training.learner import Learner
from fishrl.training.scaling import InputScale
from tests.training.conftest import ALGORITHMS, Toy, answer


def learn(toy: Toy, algorithm: Algorithm, **settings: object) -> Learner:
    """Return a learner of scaled inputs after six gradient steps."""
    learner = toy.collect(algorithm, scale_inputs=True, **settings)
    for _ in range(6):
        learner.update()
    return learner


@pytest.mark.parametrize("hidden", [(16,), (16, 16)], ids=["one layer", "two layers"])
@pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda a: type(a).__name__)
def test_saved_equals_learner(toy: Toy, algorithm: Algorithm, hidden: tuple[int, ...]) -> None:
    learner = learn(toy, algorithm, hidden=hidden)
    states = next(iter(toy.trainings[0].collector)).reshape(-1)
    saved, own = (answer(policy, states) for policy in (learner.actor, learner.explorer))
    torch.testing.assert_close(saved, own, rtol=1e-4, atol=1e-5)  # float32


@pytest.mark.parametrize("is_continuous", [False, True])
def test_first_rollout_stays_that_of_the_policy(toy: Toy, is_continuous: bool) -> None:
    learner = toy.collect(
        PPO(rollout_length=8), scale_inputs=True, task={"is_continuous": is_continuous}
    )
    found = learner.update()
    assert float(found["clip_fraction"]) == 0.0
    assert float(found["kl_approx"]) == pytest.approx(0.0, abs=1e-4)  # float32


def test_loss_reads_zero_mean_and_unit_deviation(toy: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    learner = learn(toy, DQN())
    seen: list[TensorDictBase] = []
    monkeypatch.setattr(learner.loss, "forward", lambda batch: seen.append(batch) or {})
    with pytest.raises(AttributeError):  # there are no losses
        learner._take_step(learner.buffer[:])
    raw, (read,) = learner.buffer[:], seen
    numbers = read["observation_stack"].unflatten(-1, (4, 4)).flatten(0, 1)
    torch.testing.assert_close(numbers.mean(0), torch.zeros(4), rtol=0.0, atol=1e-5)
    torch.testing.assert_close(numbers.std(0, correction=0), torch.ones(4))
    change = raw["next", "observation_stack"] - raw["observation_stack"]
    scaled = read["next", "observation_stack"] - read["observation_stack"]
    deviation = raw["observation_stack"].unflatten(-1, (4, 4)).flatten(0, 1).std(0, correction=0)
    torch.testing.assert_close(scaled, change / deviation.repeat(4), rtol=1e-4, atol=1e-5)


def test_constant_numbers_are_only_shifted() -> None:
    scale = InputScale({"observation_stack": (4, 2)})
    stack = torch.tensor([[5.0, 1.0, 5.0, 3.0], [5.0, 1.0, 5.0, 3.0]])
    scale.measure_(TensorDict({"observation_stack": stack}, [2]))
    scaled = scale(TensorDict({"observation_stack": stack + torch.tensor([2.0, 0, 0, 0])}, [2]))
    expected = torch.tensor([2.0, -1.0, 0.0, 1.0]).expand(2, -1)
    torch.testing.assert_close(scaled["observation_stack"], expected)
