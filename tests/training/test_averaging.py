"""The average of the weights acts, is saved and loaded; the newest weights explore."""

import copy

import pytest
import torch
from torch import nn

from fishrl.training import Algorithm, load_policy
from fishrl.training.averaging import WeightAverage
from tests.training.conftest import ALGORITHMS, QUICK, Toy


def test_average_is_a_mean_at_first_and_exponential_later() -> None:
    policy = nn.Linear(1, 1, bias=False)
    average = WeightAverage(policy, horizon=4.0)  # type: ignore[arg-type]
    for weight in (1.0, 2.0, 6.0, 7.0):
        nn.init.constant_(policy.weight, weight)
        average.step()
    assert average.policy.weight.item() == pytest.approx(4.0)
    nn.init.constant_(policy.weight, 8.0)
    average.step()
    assert average.policy.weight.item() == pytest.approx(4.0 + (8.0 - 4.0) / 4.0)


@pytest.mark.usefixtures("traced_at_once")
@pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda a: type(a).__name__)
def test_policy_is_the_mean_over_gradient_steps(toy: Toy, algorithm: Algorithm) -> None:
    learner = toy.collect(algorithm, actor_average=10_000)
    seen: list[dict[str, torch.Tensor]] = []
    for _ in range(6):  # some are traced
        learner.update()
        weights = dict(learner.explorer.named_parameters())
        seen.append(copy.deepcopy({name: weights[name].detach() for name in weights}))
    mean = {name: torch.stack([each[name] for each in seen]).mean(0) for name in seen[0]}
    averaged = list(learner.actor.parameters())
    assert len(averaged) == len(mean)
    for value, expected in zip(averaged, mean.values(), strict=True):
        torch.testing.assert_close(value, expected)
        assert not value.requires_grad


def test_averaged_policy_is_saved_and_loaded(toy: Toy) -> None:
    training = toy.begin(name="run", actor_average=60, total_frames=120, **QUICK)
    training.run()
    mean, newest = (
        part.state_dict() for part in (training.learner.actor, training.learner.explorer)
    )
    for name, value in load_policy(toy.folder / "run").state_dict().items():
        assert torch.equal(value, mean[name])
        assert not torch.equal(value, newest[name])
