"""A training that begins with the policy of another, whose critics may learn before it does."""

from typing import Any

import pytest
import torch
from torchrl.objectives import LossModule

from fishrl.training import Algorithm, load_policy
from fishrl.training.algorithms.discrete_sac import DiscreteSAC
from fishrl.training.algorithms.sac import SAC
from fishrl.training.learner import Learner
from tests.training.conftest import ACTOR_CRITICS, QUICK, Toy, answer


def make_learner(toy: Toy, algorithm: Algorithm, **settings: object) -> Learner:
    """Return a learner whose policy began as that of a finished training, with some transitions."""
    task = {"is_continuous": isinstance(algorithm, SAC)}
    toy.begin(name="first", algorithm=algorithm, task=task, **QUICK).run()
    first = str(toy.folder / "first")
    return toy.collect(algorithm, initial_policy=first, critic_frames=400, **settings)


@pytest.mark.parametrize("is_scaled", [False, True], ids=["raw", "scaled"])
@pytest.mark.parametrize("algorithm", ACTOR_CRITICS, ids=lambda a: type(a).__name__)
def test_policy_acts_as_the_initial_one_while_critics_learn(
    toy: Toy, algorithm: Algorithm, is_scaled: bool, traced_at_once: None
) -> None:
    learner = make_learner(toy, algorithm, scale_inputs=is_scaled, actor_average=100)
    states = next(iter(toy.trainings[-1].collector)).reshape(-1)
    expected = answer(load_policy(toy.folder / "first"), states)
    learner.rest_actor(True)
    learner.update()  # the first one folds the scale into the weights
    before = [weight.clone() for weight in learner.loss.parameters()]
    for _ in range(3):
        learner.update()
    for policy in (learner.explorer, learner.actor):
        torch.testing.assert_close(answer(policy, states), expected, rtol=1e-3, atol=1e-4)
    changed = {
        name.split("_network")[0]
        for (name, weight), old in zip(learner.loss.named_parameters(), before, strict=True)
        if not torch.equal(weight, old)
    }
    assert changed <= {"critic", "qvalue"}  # no temperature, either
    assert changed
    learner.rest_actor(False)
    learner.update()  # the average begins here
    torch.testing.assert_close(answer(learner.explorer, states), answer(learner.actor, states))
    for _ in range(4):
        learner.update()
    assert not torch.allclose(
        *(next(iter(found.values())) for found in (answer(learner.explorer, states), expected))
    )


class RenamedLoss(DiscreteSAC):
    """Its loss has other names than those of the library."""

    def make_loss(self, *given: Any) -> LossModule:
        loss = super().make_loss(*given)
        loss.out_keys = [name.replace("qvalue", "values") for name in loss.out_keys]
        return loss


def test_critics_without_a_known_loss_cannot_learn_alone(toy: Toy) -> None:
    with pytest.raises(ValueError, match="critic_frames = 80: none of the outputs"):
        toy.begin(name="own", algorithm=RenamedLoss(), critic_frames=80, **QUICK)


def test_policy_rests_until_its_critics_have_learned(toy: Toy) -> None:
    toy.begin(name="first", **QUICK).run()
    weights = load_policy(toy.folder / "first").state_dict()
    given = {"initial_policy": str(toy.folder / "first"), "critic_frames": 80, **QUICK}
    for frames, is_equal in ((152, True), (160, True), (168, False)):
        training = toy.begin(name=f"{frames}", **given, total_frames=frames)
        training.run()
        own = training.learner.explorer.state_dict()
        assert all(torch.equal(own[name], value) for name, value in weights.items()) == is_equal
