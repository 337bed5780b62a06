"""Policies and critics: masks, exploration, seeds and recurrent state."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from fishrl.modules import (
    EpsilonGreedy,
    RecurrentPolicy,
    make_actor,
    make_continuous_actor,
    make_recurrent_value_actor,
    make_twin_critics,
    make_value_actor,
)

make_exploration = partial(EpsilonGreedy, Categorical(3), action_mask_key="action_mask")


def states(num: int, *, key: str = "observation_stack") -> TensorDict:
    """Return states of 16 numbers with three actions, at least one of them legal."""
    generator = torch.Generator().manual_seed(0)
    mask = torch.rand(num, 3, generator=generator) > 0.5
    mask[torch.arange(num), torch.randint(3, (num,), generator=generator)] = True
    seen = torch.randn(num, 16, generator=generator)
    is_init = torch.zeros(num, 1, dtype=torch.bool)
    return TensorDict({key: seen, "action_mask": mask, "is_init": is_init}, [num])


def test_illegal_actions_have_probability_zero() -> None:
    td = states(500)
    actor = make_actor(num_inputs=16, num_actions=3, hidden=(32,))
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        actor[0].module[-1].bias.fill_(-2000.0)  # legal logits far below a small "minus infinity"
        out, probs = actor(td.clone()), actor.get_dist(td).probs
    legal_logits = out["logits"].masked_fill(~td["action_mask"], -torch.inf)
    assert torch.equal(out["action"], legal_logits.argmax(-1))
    assert (probs[~td["action_mask"]] == 0).all()
    assert torch.allclose(probs.sum(-1), torch.ones(500))


def test_continuous_actions_are_bounded_and_deterministic_on_request() -> None:
    td = states(2000).exclude("action_mask")
    actor = make_continuous_actor(num_inputs=16, num_actions=2, hidden=(32,))
    for kind in (ExplorationType.RANDOM, ExplorationType.DETERMINISTIC):
        with set_exploration_type(kind), torch.no_grad():
            first, second = (actor(td.clone()) for _ in range(2))
        assert first["action"].shape == (2000, 2) and first["action"].abs().max() <= 1.0
        is_same = torch.equal(first["action"], second["action"])
        assert is_same is (kind is ExplorationType.DETERMINISTIC)
    assert torch.equal(first["action"], first["loc"].tanh())


def test_twin_critics_differ_and_stay_bounded_in_far_states() -> None:
    td, other = (states(10).set("action", torch.full((10, 2), value)) for value in (0.0, 1.0))
    make = partial(make_twin_critics, num_inputs=16, hidden=(32,))
    per_action, twins = make(num_actions=3), make(num_actions=2, reads_action=True, is_normed=True)
    for critics, key, width in ((per_action, "action_value", 3), (twins, "state_action_value", 1)):
        values = [critic(td.clone())[key] for critic in critics]
        assert values[0].shape == (10, width)
        assert not torch.allclose(*values)
    assert not torch.allclose(twins[0](other)["state_action_value"], values[0])
    far = TensorDict({"observation_stack": 1e6 * torch.randn(10, 16), "action": torch.ones(10, 2)})
    assert twins[0](far)["state_action_value"].abs().max() < 10.0


def test_epsilon_greedy_actions_are_legal() -> None:
    torch.manual_seed(0)
    td = states(4000)
    greedy = make_value_actor(num_inputs=16, num_actions=3, hidden=(8,))
    chance = make_exploration(eps_init=0.5, eps_end=0.5)
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
    # half of the random actions in states with two legal ones differ from the best
    has_two = td["action_mask"].sum(-1) == 2
    share = (taken != best["action"])[has_two].double().mean()
    assert share.item() == pytest.approx(0.25, abs=0.05)  # 4 standard errors of ~1500 states


def test_epsilon_decays_in_exploration_only() -> None:
    chance = make_exploration(eps_end=0.1, annealing_num_steps=100)
    td = states(20).set("action", torch.zeros(20, dtype=torch.int64))
    td["action_mask"][:] = True
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        chance(td.clone())
    assert float(chance.eps) == 1.0
    chance(td.clone())
    assert float(chance.eps) == pytest.approx(0.82)
    other = make_exploration()
    other.load_state_dict(chance.state_dict())
    assert torch.equal(other.eps, chance.eps)
    for _ in range(9):
        chance(td.clone())
    assert float(chance.eps) == pytest.approx(0.1)


def test_recurrent_state_is_per_row_and_episode() -> None:
    network = make_recurrent_value_actor(num_inputs=16, num_actions=3, hidden=(8, 16))
    policy, alone = RecurrentPolicy(network), RecurrentPolicy(network)
    torch.manual_seed(0)
    steps = [states(2, key="observation") for _ in range(6)]
    for i, step in enumerate(steps):
        step["observation"] = torch.randn(2, 16)
        step["is_init"] = torch.tensor([[i == 0], [i in (0, 3)]])  # row 1 restarts
        policy(step)
        assert list(step.keys()) == ["observation", "action_mask", "is_init", "action"]
    for step in steps[3:]:
        alone(step[1:].clone())
    for key, value in policy._memory.items():
        torch.testing.assert_close(value[1:], alone._memory[key])
        assert not torch.allclose(value[:1], alone._memory[key])
    alone(steps[0].clone())  # another number of rows resets the state
    fresh = RecurrentPolicy(network)
    fresh(steps[0].clone())
    assert all(torch.equal(alone._memory[key], fresh._memory[key]) for key in fresh._memory)
