"""Rollouts give the advantages of generalised advantage estimation, flow by flow."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from fishrl.training.algorithms.ppo import PPO
from fishrl.training.on_policy import Rollout
from tests.training.conftest import Toy


def test_decisions_are_joined_flow_by_flow_and_survive_a_checkpoint() -> None:
    seen = []
    first, second = (Rollout(3, lambda whole: seen.append(whole.clone())) for _ in range(2))
    decisions = [TensorDict({"x": torch.tensor([t, 10 + t])}, [2]) for t in range(3)]
    assert first.add(decisions[0]) is None
    decisions[0].zero_()  # as a collector that uses its memory again
    second.load_state_dict(first.state_dict())
    assert not second.is_complete and second.add(decisions[1]) is None
    whole = second.add(decisions[2])
    assert whole is not None and second.is_complete
    assert whole["x"].tolist() == [0, 1, 2, 10, 11, 12]
    assert seen[0]["x"].tolist() == [[0, 1, 2], [10, 11, 12]]


def test_advantages_are_those_of_the_definition(toy: Toy) -> None:
    """Schulman et al. 2016, eq. 16; a truncated episode bootstraps, a terminated one does not."""
    length, gamma, decay = 40, 0.9, 0.8
    algorithm = PPO(rollout_length=length, gae_lambda=decay)
    training = toy.begin(algorithm=algorithm, gamma=gamma, task={"time_limit": 12})
    batches = iter(training.collector)
    for _ in range(length):
        training.learner.store(next(batches).reshape(-1))
    kept = training.learner.buffer[:].reshape(8, length)
    critic = training.learner.loss.critic_network
    with training.learner.loss.critic_network_params.to_module(critic), torch.no_grad():
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


def test_nothing_is_learned_before_a_rollout_is_complete(toy: Toy) -> None:
    training = toy.begin(algorithm=PPO(rollout_length=3), batch_size=8)
    batches, ready = iter(training.collector), []
    for _ in range(6):
        training.learner.store(next(batches).reshape(-1))
        ready.append(training.learner.is_ready)
    assert ready == [False, False, True] * 2
    assert training.learner.buffer[:]["advantage"].std() > 0.0


@pytest.mark.learning
@pytest.mark.parametrize("is_continuous", [pytest.param(False, marks=pytest.mark.slow), True])
def test_ppo_learns_to_catch_still_food(toy: Toy, is_continuous: bool) -> None:
    summary = toy.begin(
        task={"food_speed_bl": 0.0, "is_continuous": is_continuous},
        algorithm=PPO(rollout_length=16),
        num_envs=32,
        total_frames=6_144,
        learning_rate=2e-3,
        hidden=(64, 64),
        eval_frames=2_048,
        eval_episodes=10,
        final_episodes=32,
        checkpoint_frames=6_144,
        baselines=("random",),
    ).run()
    # This seed gave 32 captures of 32 with either kind of action, random actions 9 and 3.
    assert summary["success_rate"] >= 0.75
    assert summary["random_success_rate"] <= 0.4
