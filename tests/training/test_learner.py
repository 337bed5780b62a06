"""What is remembered, and that remembering does not grow."""

import gc
from dataclasses import replace
from typing import Any

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.objectives import DQNLoss

from fishrl.training import DiscreteSAC
from fishrl.training.algorithms.dqn import DQN
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.metrics import measure_memory_mb
from fishrl.training.policy_spec import PolicySpec
from tests.training.conftest import QUICK, Toy


def test_diverged_transitions_are_not_stored_and_illegal_states_refused(toy: Toy) -> None:
    training = toy.begin()
    batch = next(iter(training.collector)).reshape(-1)
    batch["next", "diverged"][3] = True
    assert training.learner.store(batch) == 1
    assert len(training.learner.buffer) == 8 - 1
    batch["next", "action_mask"][4] = False
    with pytest.raises(ValueError, match="a state has no legal action"):
        training.learner.store(batch)


class Unnamed(DQN):
    """An algorithm with a loss of TorchRL whose output has another name."""

    def make_loss(self, policy: Any, spec: PolicySpec, generator: torch.Generator) -> DQNLoss:
        return DQNLoss(policy, action_space="categorical")


def test_loss_without_named_outputs_is_refused(toy: Toy) -> None:
    with pytest.raises(ValueError, match=r"DQNLoss has the outputs \['loss'\]: the sum of those"):
        toy.begin(algorithm=Unnamed())


def count_tensors() -> int:
    """Count them by type: ``isinstance`` asks proxies, which import, or refer to what is gone."""
    gc.collect()
    return sum(issubclass(type(thing), torch.Tensor) for thing in gc.get_objects())


@pytest.mark.usefixtures("traced_at_once")
@pytest.mark.parametrize("algorithm", [DiscreteSAC(), DRQN()], ids=["sac", "drqn"])
def test_memory_does_not_grow_with_frames(toy: Toy, algorithm: DiscreteSAC | DRQN) -> None:
    training = toy.begin(
        algorithm=algorithm,
        buffer_size=100,
        total_frames=160,
        task={"time_limit": 5},
        eval_frames=80,
        **QUICK,
    )
    training.run()
    tensors, megabytes = count_tensors(), measure_memory_mb()
    training.plan = replace(training.plan, total_frames=400)
    training.run()
    assert count_tensors() <= tensors + 5
    assert measure_memory_mb() < megabytes + 10.0  # allocators keep some; a frame is 5 kB


@pytest.mark.parametrize("key", ["reward", "observation_stack"])
def test_number_that_is_not_finite_ends_a_training_unless_the_flow_diverged(
    toy: Toy, key: str
) -> None:
    learner = toy.collect(DiscreteSAC(), 1)
    batch = next(iter(toy.trainings[0].collector)).reshape(-1)
    batch["next", key][2] = torch.nan
    batch["next", "diverged"][2] = True
    assert learner.store(batch.clone()) == 1
    batch["next", "diverged"][2] = False
    with pytest.raises(ValueError, match=f"{key}.*is not finite"):
        learner.store(batch)


def test_explorer_without_an_action_is_refused(toy: Toy) -> None:
    class Mute(DiscreteSAC):
        def make_explorer(self, policy: Any, spec: Any) -> TensorDictModule:
            return TensorDictModule(torch.nn.Linear(16, 3), ["observation_stack"], ["actoin"])

    with pytest.raises(ValueError, match="an explorer must write an 'action'"):
        toy.begin(algorithm=Mute())
