"""The networks: shapes, legality, and that one seed gives one network."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from fishrl.modules import (
    make_actor,
    make_continuous_actor,
    make_twin_action_critics,
    make_twin_critics,
)


def states(num: int, *, num_actions: int = 3) -> TensorDict:
    generator = torch.Generator().manual_seed(0)
    mask = torch.rand(num, num_actions, generator=generator) > 0.5
    mask[torch.arange(num), torch.randint(num_actions, (num,), generator=generator)] = True
    stack = torch.randn(num, 16, generator=generator)
    return TensorDict({"observation_stack": stack, "action_mask": mask}, [num])


def test_illegal_actions_have_probability_zero_and_the_greedy_one_is_the_most_probable() -> None:
    td = states(500)
    actor = make_actor(num_inputs=16, num_actions=3, hidden=(32,))
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        actor[0].module[-1].bias.fill_(-2000.0)  # legal logits far below a small "minus infinity"
        out, probs = actor(td.clone()), actor.get_dist(td).probs
    legal_logits = out["logits"].masked_fill(~td["action_mask"], -torch.inf)
    assert torch.equal(out["action"], legal_logits.argmax(-1))
    assert (probs[~td["action_mask"]] == 0).all()
    assert torch.allclose(probs.sum(-1), torch.ones(500))


def test_seed_fixes_the_network_without_the_global_generator() -> None:
    def weights(seed: int) -> list[torch.Tensor]:
        generator = torch.Generator().manual_seed(seed)
        actor = make_actor(num_inputs=16, num_actions=3, generator=generator)
        return list(actor.parameters())

    torch.manual_seed(1)
    first = weights(7)
    torch.manual_seed(2)
    second, other = weights(7), weights(8)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    assert not torch.equal(first[0], other[0])


def test_continuous_actions_are_bounded_and_greedy_ones_follow_from_the_state() -> None:
    td = states(2000).exclude("action_mask")
    actor = make_continuous_actor(num_inputs=16, num_actions=2, hidden=(32,))
    drawn = {}
    for kind in (ExplorationType.RANDOM, ExplorationType.DETERMINISTIC):
        with set_exploration_type(kind), torch.no_grad():
            drawn[kind] = [actor(td.clone()) for _ in range(2)]
        for out in drawn[kind]:
            assert out["action"].shape == (2000, 2) and out["action"].abs().max() <= 1.0
    first, second = drawn[ExplorationType.DETERMINISTIC]
    assert torch.equal(first["action"], first["loc"].tanh())
    assert torch.equal(first["action"], second["action"])
    first, second = drawn[ExplorationType.RANDOM]
    assert not torch.allclose(first["action"], second["action"])


def test_twin_critics_differ_read_the_action_and_stay_bounded_in_far_states() -> None:
    td, other = (states(10).set("action", torch.full((10, 2), value)) for value in (0.0, 1.0))
    per_action = make_twin_critics(num_inputs=16, num_actions=3, hidden=(32,))
    twins = make_twin_action_critics(num_inputs=16, num_actions=2, hidden=(32,))
    for critics, key, width in ((per_action, "action_value", 3), (twins, "state_action_value", 1)):
        values = [critic(td.clone())[key] for critic in critics]
        assert values[0].shape == (10, width)
        assert not torch.allclose(*values)
    assert not torch.allclose(twins[0](other)["state_action_value"], values[0])
    far = TensorDict({"observation_stack": 1e6 * torch.randn(10, 16), "action": torch.ones(10, 2)})
    assert twins[0](far)["state_action_value"].abs().max() < 10.0
