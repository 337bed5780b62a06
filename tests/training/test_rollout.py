"""Rollouts give the advantages of generalised advantage estimation, flow by flow."""

import torch

from fishrl.training.algorithms.ppo import PPO
from tests.training.conftest import Toy


def test_rollout_joins_decisions_per_flow_and_survives_checkpoint(toy: Toy) -> None:
    """Also where a collector reuses the memory of its batches."""
    first, second = (
        toy.begin(algorithm=PPO(rollout_length=3), batch_size=8, name=name).learner
        for name in ("first", "second")
    )
    batches = iter(toy.trainings[0].collector)
    decisions = [next(batches).reshape(-1).clone() for _ in range(3)]
    expected = torch.stack([each["observation"].clone() for each in decisions], 1)
    first.store(decisions[0])
    decisions[0].zero_()
    second.components()["rollout"].load_state_dict(first.components()["rollout"].state_dict())
    for decision in decisions[1:]:
        assert not second.is_ready
        second.store(decision)
    assert second.is_ready and len(second.buffer) == 8 * 3
    kept = second.buffer[:]["observation_stack"].reshape(8, 3, -1)[..., -4:]
    assert torch.equal(kept, expected)


def test_advantages_match_the_definition_of_gae(toy: Toy) -> None:
    """Schulman et al. 2016, eq. 16; a truncated episode bootstraps, a terminated one does not."""
    length, gamma, decay = 40, 0.9, 0.8
    algorithm = PPO(rollout_length=length, gae_lambda=decay)
    learner = toy.collect(algorithm, length, gamma=gamma, task={"time_limit": 12})
    kept, critic = learner.buffer[:].reshape(8, length), learner.loss.critic_network
    with learner.loss.critic_network_params.to_module(critic), torch.no_grad():
        before = critic(kept.clone())["state_value"]
        after = critic(kept["next"].clone())["state_value"]
    done, terminated = (kept["next", name] for name in ("done", "terminated"))
    assert terminated.any() and (done & ~terminated).any()
    delta = kept["next", "reward"] + gamma * after * ~terminated - before
    expected, later = torch.zeros_like(delta), torch.zeros(8, 1)
    for t in reversed(range(length)):
        later = delta[:, t] + gamma * decay * ~done[:, t] * later
        expected[:, t] = later
    torch.testing.assert_close(kept["advantage"], expected, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(kept["value_target"], expected + before, rtol=1e-4, atol=1e-4)
