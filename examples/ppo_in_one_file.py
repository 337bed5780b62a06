"""PPO in one file, in the manner of CleanRL, on fish: torch, numpy and Gymnasium's interface alone.

    python examples/ppo_in_one_file.py --total-steps 20000
    python examples/ppo_in_one_file.py --task gait        # macro-actions, with masks

Only ``make_fish`` and ``main`` are specific to fishrl.
"""

import argparse
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical

from fishrl.envs import AbstractTask, Flows, KarmanGait, Predation, make_env
from fishrl.wrappers.gymnasium import FlowVectorEnv


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Hyper-parameters; see Schulman et al. 2017, and Huang et al. 2022 for the details."""

    total_steps: int = 20_000
    num_steps: int = 32
    num_epochs: int = 4
    num_minibatches: int = 4
    learning_rate: float = 2.5e-4
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.01
    value_weight: float = 0.5
    max_norm: float = 0.5
    seed: int = 0


class Agent(nn.Module):
    """Actor and critic; illegal actions have probability zero."""

    def __init__(self, envs: gym.vector.VectorEnv) -> None:
        super().__init__()
        num_inputs = int(np.prod(envs.single_observation_space.shape))
        self.actor = _make_network(num_inputs, int(envs.single_action_space.n), gain=0.01)
        self.critic = _make_network(num_inputs, 1, gain=1.0)

    def decide(self, observation: Tensor, mask: Tensor) -> Categorical:
        """Return the distribution of actions."""
        return Categorical(logits=self.actor(observation).masked_fill(~mask, -1e9))

    def value(self, observation: Tensor) -> Tensor:
        """Return the value ``[...]``."""
        return self.critic(observation).squeeze(-1)


def _make_network(num_inputs: int, num_outputs: int, *, gain: float) -> nn.Sequential:
    layers = [nn.Linear(num_inputs, 64), nn.Linear(64, 64), nn.Linear(64, num_outputs)]
    for layer, size in zip(layers, (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, size)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


def train(envs: gym.vector.VectorEnv, settings: Settings) -> tuple[Agent, list[float]]:
    """Train on environments that reset in the same step; return the agent and all returns."""
    assert envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode.SAME_STEP
    torch.manual_seed(settings.seed)
    agent = Agent(envs)
    optimiser = torch.optim.Adam(agent.parameters(), lr=settings.learning_rate, eps=1e-5)
    returns: list[float] = []
    observation, infos = envs.reset(seed=settings.seed)
    for _ in range(settings.total_steps // (settings.num_steps * envs.num_envs)):
        steps: list[dict[str, Tensor]] = []
        for _ in range(settings.num_steps):
            seen = torch.as_tensor(observation)
            mask = torch.as_tensor(infos["action_mask"], dtype=torch.bool)
            with torch.no_grad():
                decision, value = agent.decide(seen, mask), agent.value(seen)
            action = decision.sample()
            observation, reward, terminated, truncated, infos = envs.step(action.numpy())
            after = observation.copy()
            for row in (terminated | truncated).nonzero()[0]:
                after[row] = infos["final_obs"][row]
                returns.append(float(infos["final_info"]["episode_reward"][row]))
            with torch.no_grad():
                value_after = agent.value(torch.as_tensor(after))
            steps.append(
                {
                    "observation": seen,
                    "mask": mask,
                    "action": action,
                    "log_prob": decision.log_prob(action),
                    "value": value,
                    "value_after": value_after * torch.as_tensor(~terminated),
                    "reward": torch.as_tensor(reward, dtype=torch.float32),
                    "goes_on": torch.as_tensor(~(terminated | truncated), dtype=torch.float32),
                }
            )
        batch = {name: torch.stack([step[name] for step in steps]) for name in steps[0]}
        batch["advantage"] = _estimate_advantage(batch, settings)
        _update(agent, optimiser, {n: t.flatten(0, 1) for n, t in batch.items()}, settings)
    return agent, returns


def _estimate_advantage(batch: dict[str, Tensor], settings: Settings) -> Tensor:
    delta = batch["reward"] + settings.gamma * batch["value_after"] - batch["value"]
    decay = settings.gamma * settings.gae_lambda * batch["goes_on"]
    advantage = torch.zeros_like(delta)
    last = torch.zeros_like(delta[0])
    for t in reversed(range(len(delta))):
        advantage[t] = last = delta[t] + decay[t] * last
    return advantage


def _update(
    agent: Agent,
    optimiser: torch.optim.Optimizer,
    batch: dict[str, Tensor],
    settings: Settings,
) -> None:
    num = len(batch["action"])
    target = batch["advantage"] + batch["value"]
    for _ in range(settings.num_epochs):
        for rows in torch.randperm(num).chunk(settings.num_minibatches):
            decision = agent.decide(batch["observation"][rows], batch["mask"][rows])
            ratio = (decision.log_prob(batch["action"][rows]) - batch["log_prob"][rows]).exp()
            advantage = batch["advantage"][rows]
            advantage = (advantage - advantage.mean()) / (advantage.std(correction=0) + 1e-8)
            clipped = ratio.clamp(1.0 - settings.clip, 1.0 + settings.clip)
            loss = -torch.minimum(ratio * advantage, clipped * advantage).mean()
            value_loss = (agent.value(batch["observation"][rows]) - target[rows]).square().mean()
            loss = loss + settings.value_weight * 0.5 * value_loss
            loss = loss - settings.entropy_weight * decision.entropy().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), settings.max_norm)
            optimiser.step()


def make_fish(task: AbstractTask, flows: Flows) -> FlowVectorEnv:
    """Return fish as a Gymnasium vector environment."""
    env = make_env(task=task, flows=flows)
    return FlowVectorEnv(env, autoreset_mode="SameStep")


def main() -> None:
    """Train and print the mean returns."""
    parser = argparse.ArgumentParser(description="PPO in one file, on fish.")
    parser.add_argument("--task", choices=["predation", "gait"], default="predation")
    parser.add_argument("--total-steps", type=int, default=Settings.total_steps)
    parser.add_argument("--num-envs", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    task = Predation() if chosen.task == "predation" else KarmanGait(start_flows=(1,))
    envs = make_fish(task, Flows(num_envs=chosen.num_envs))
    _, returns = train(envs, Settings(total_steps=chosen.total_steps, seed=chosen.seed))
    envs.close()
    tenth = max(1, len(returns) // 10)
    if returns:
        first, last = np.mean(returns[:tenth]), np.mean(returns[-tenth:])
        print(f"{len(returns)} episodes; mean return: first tenth {first:.2f}, last {last:.2f}")


if __name__ == "__main__":
    main()
