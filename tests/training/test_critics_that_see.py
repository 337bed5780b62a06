"""Critics read what the task gives to them alone; policies neither need nor notice it."""

import pytest
import torch

from fishrl.envs import Flows
from fishrl.training import Algorithm, evaluate
from fishrl.training.algorithms.ppo import PPO
from tests.training.conftest import ACTOR_CRITICS, QUICK, Toy
from tests.training.toy_fish import ToyPredation

#: Names of the value losses of these algorithms.
VALUE_LOSSES = {"loss_qvalue", "loss_critic"}
SEEING = {"critic_observes": ("heading",)}


@pytest.mark.parametrize("reads_stack", [True, False])
@pytest.mark.parametrize("algorithm", ACTOR_CRITICS, ids=lambda a: type(a).__name__)
def test_values_alone_depend_on_critics(toy: Toy, algorithm: Algorithm, reads_stack: bool) -> None:
    learner = toy.collect(algorithm, task=SEEING | {"critic_reads_stack": reads_stack})
    batch = learner.buffer[:]
    assert batch["critic_stack"].shape == batch["next", "critic_stack"].shape == (64, 4)
    losses, policies = [], []
    for place in (None, "critic_stack", ("next", "critic_stack"), "observation_stack"):
        changed = batch.clone()
        if place is not None:
            changed[place] += 1.0
        torch.manual_seed(0)
        with torch.no_grad():
            policies.append(learner.actor(changed.clone()))
            found = learner.loss(changed)
        losses.append({name: float(found[name]) for name in VALUE_LOSSES if name in found})
    assert losses[1] != losses[0]
    # PPO's targets were computed before
    assert (losses[2] != losses[0]) != isinstance(algorithm, PPO)
    assert (losses[3] != losses[0]) == reads_stack
    for policy in policies[1:3]:
        for key in ("logits", "loc"):
            assert key not in policy or torch.equal(policy[key], policies[0][key])


def test_estimates_of_ppo_bootstrap_from_what_its_critic_sees(toy: Toy) -> None:
    learner = toy.collect(PPO(rollout_length=8), task=SEEING | {"critic_reads_stack": False})
    values = learner.buffer[:]["value_target"]
    assert values.std() > 0.0
    assert learner.update()["loss_critic"] > 0.0


def test_policy_acts_in_a_task_without_what_critics_saw(toy: Toy) -> None:
    summary = toy.begin(name="run", task=SEEING, total_frames=120, **QUICK).run()
    few = {"episodes": 2, "flows": Flows(num_envs=2)}
    result = evaluate(toy.folder / "run", task=ToyPredation(), **few)
    assert result["mean_return"] == summary["mean_return"]
