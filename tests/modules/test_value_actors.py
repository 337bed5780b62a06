"""Policies of value-based algorithms: legality, chance, and what they remember."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.envs.utils import ExplorationType, set_exploration_type

from fishrl.modules import (
    EpsilonGreedy,
    RecurrentPolicy,
    make_recurrent_value_actor,
    make_value_actor,
)


def states(num: int, *, key: str = "observation_stack") -> TensorDict:
    generator = torch.Generator().manual_seed(0)
    mask = torch.rand(num, 3, generator=generator) > 0.5
    mask[torch.arange(num), torch.randint(3, (num,), generator=generator)] = True
    seen = torch.randn(num, 4, generator=generator)
    is_init = torch.zeros(num, 1, dtype=torch.bool)
    return TensorDict({key: seen, "action_mask": mask, "is_init": is_init}, [num])


def test_epsilon_greedy_actions_are_legal() -> None:
    torch.manual_seed(0)
    td = states(4000)
    greedy = make_value_actor(num_inputs=4, num_actions=3, hidden=(8,))
    chance = EpsilonGreedy(num_actions=3, start=0.5, end=0.5)
    with torch.no_grad():
        best = greedy(td.clone())
        taken = TensorDictSequential(greedy, chance)(td.clone())["action"]
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            settled = TensorDictSequential(greedy, chance)(td.clone())["action"]
    assert torch.equal(settled, best["action"])
    for action in (best["action"], taken):
        assert td["action_mask"].gather(1, action[:, None]).all()
    values = best["action_value"].masked_fill(~td["action_mask"], -torch.inf)
    assert torch.equal(best["action"], values.argmax(-1))
    # Half of the random actions of states with two legal ones differ from the best one.
    has_two = td["action_mask"].sum(-1) == 2
    share = (taken != best["action"])[has_two].double().mean()
    assert share.item() == pytest.approx(0.25, abs=0.05)  # 4 standard errors of ~1500 states


def test_epsilon_decays_in_training_alone() -> None:
    chance = EpsilonGreedy(num_actions=3, start=1.0, end=0.1, num_frames=100)
    td = states(20).set("action", torch.zeros(20, dtype=torch.int64))
    td["action_mask"][:] = True
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        chance(td.clone())
    assert float(chance.eps) == 1.0
    chance(td.clone())
    assert float(chance.eps) == pytest.approx(0.82)
    other = EpsilonGreedy(num_actions=3)
    other.load_state_dict(chance.state_dict())
    assert torch.equal(other.eps, chance.eps)
    for _ in range(9):
        chance(td.clone())
    assert float(chance.eps) == pytest.approx(0.1)


def test_recurrent_policy_remembers_each_rows_own_episode() -> None:
    network = make_recurrent_value_actor(num_inputs=4, num_actions=3, hidden=(8, 16))
    policy, alone = RecurrentPolicy(network), RecurrentPolicy(network)
    torch.manual_seed(0)
    steps = [states(2, key="observation") for _ in range(6)]
    for i, step in enumerate(steps):
        step["observation"] = torch.randn(2, 4)
        step["is_init"] = torch.tensor([[i == 0], [i in (0, 3)]])  # the second row begins again
        policy(step)
        assert list(step.keys()) == ["observation", "action_mask", "is_init", "action"]
    for step in steps[3:]:
        alone(step[1:].clone())
    for key, value in policy._memory.items():
        torch.testing.assert_close(value[1:], alone._memory[key])
        assert not torch.allclose(value[:1], alone._memory[key])
    alone(steps[0].clone())  # two rows again: nothing is remembered
    fresh = RecurrentPolicy(network)
    fresh(steps[0].clone())
    assert all(torch.equal(alone._memory[key], fresh._memory[key]) for key in fresh._memory)
