"""IPPO or MAPPO for two fish, following TorchRL's multi-agent tutorial.

    python examples/ippo_pair.py --frames 20000
    python examples/ippo_pair.py --frames 20000 --central     # MAPPO: a critic that observes both

Only ``main`` is specific to fish; ``train`` takes any environment with one group and masks.
"""

import argparse
from dataclasses import dataclass

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.envs import EnvBase
from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

from fishrl.envs import Flows, PredationPair, make_env


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Hyper-parameters; see Schulman et al. 2017, and Yu et al. 2022 for several agents."""

    frames: int = 20_000
    frames_per_batch: int = 512
    num_epochs: int = 8
    batch_size: int = 128
    learning_rate: float = 3e-4
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.01
    max_norm: float = 1.0
    is_central: bool = False
    seed: int = 0


def make_policy(env: EnvBase, group: str) -> ProbabilisticActor:
    """Return a policy whose weights all agents of the group share."""
    logits = TensorDictModule(
        MultiAgentMLP(
            n_agent_inputs=env.observation_spec[group, "observation_stack"].shape[-1],
            n_agent_outputs=int(env.full_action_spec[env.action_key].space.n),
            n_agents=len(env.group_map[group]),
            centralized=False,
            share_params=True,
            depth=2,
            num_cells=64,
            activation_class=nn.Tanh,
        ),
        in_keys=[(group, "observation_stack")],
        out_keys=[(group, "logits")],
    )
    return ProbabilisticActor(
        logits,
        spec=env.full_action_spec_unbatched,
        in_keys={"logits": (group, "logits"), "mask": (group, "action_mask")},
        out_keys=[env.action_key],
        distribution_class=MaskedCategorical,
        distribution_kwargs={"neg_inf": -1e9},
        return_log_prob=True,
        log_prob_key=(group, "action_log_prob"),
    )


def make_critic(env: EnvBase, group: str, *, is_central: bool) -> TensorDictModule:
    """Return a critic of each agent's observation, or of those of all agents."""
    return TensorDictModule(
        MultiAgentMLP(
            n_agent_inputs=env.observation_spec[group, "observation_stack"].shape[-1],
            n_agent_outputs=1,
            n_agents=len(env.group_map[group]),
            centralized=is_central,
            share_params=True,
            depth=2,
            num_cells=64,
            activation_class=nn.Tanh,
        ),
        in_keys=[(group, "observation_stack")],
        out_keys=[(group, "state_value")],
    )


def train(env: EnvBase, settings: Settings) -> tuple[ProbabilisticActor, list[float]]:
    """Train in an environment with one group; return the policy and the returns of its agents."""
    torch.manual_seed(settings.seed)
    (group,) = env.group_map
    policy = make_policy(env, group)
    critic = make_critic(env, group, is_central=settings.is_central)
    loss = ClipPPOLoss(
        policy,
        critic,
        clip_epsilon=settings.clip,
        entropy_coeff=settings.entropy_weight,
        normalize_advantage=True,
    )
    loss.set_keys(
        reward=env.reward_key,
        action=env.action_key,
        sample_log_prob=(group, "action_log_prob"),
        value=(group, "state_value"),
        done=(group, "done"),
        terminated=(group, "terminated"),
    )
    loss.make_value_estimator(gamma=settings.gamma, lmbda=settings.gae_lambda)
    optimiser = torch.optim.Adam(loss.parameters(), settings.learning_rate)
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(settings.frames_per_batch),
        sampler=SamplerWithoutReplacement(),
        batch_size=settings.batch_size,
    )
    collector = Collector(
        env,
        policy,
        frames_per_batch=settings.frames_per_batch,
        total_frames=settings.frames,
    )
    returns: list[float] = []
    for batch in collector:
        after = batch["next"]
        shape = after.get_item_shape(env.reward_key)
        for name in ("done", "terminated"):  # of the flow, and so of each of its agents
            after[group, name] = after[name].unsqueeze(-1).expand(shape)
        returns += after[group, "episode_reward"][after[group, "done"]].tolist()
        with torch.no_grad():
            loss.value_estimator(
                batch,
                params=loss.critic_network_params,
                target_params=loss.target_critic_network_params,
            )
        buffer.extend(batch.reshape(-1))
        for _ in range(settings.num_epochs):
            for rows in buffer:
                losses = loss(rows)
                total = sum(v for name, v in losses.items() if name.startswith("loss_"))
                optimiser.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), settings.max_norm)
                optimiser.step()
        buffer.empty()
    collector.shutdown()
    return policy, returns


def main() -> None:
    """Train and print the mean returns."""
    parser = argparse.ArgumentParser(description="IPPO or MAPPO for two fish.")
    parser.add_argument("--frames", type=int, default=Settings.frames)
    parser.add_argument("--num-envs", type=int, default=16)
    parser.add_argument("--central", action="store_true", help="MAPPO: one critic of both fish")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    env = make_env(task=PredationPair(), flows=Flows(num_envs=chosen.num_envs), seed=chosen.seed)
    settings = Settings(frames=chosen.frames, is_central=chosen.central, seed=chosen.seed)
    _, returns = train(env, settings)
    tenth = max(1, len(returns) // 10)
    if returns:
        first, last = (sum(part) / len(part) for part in (returns[:tenth], returns[-tenth:]))
        print(f"{len(returns)} episodes; mean return: first tenth {first:.2f}, last {last:.2f}")


if __name__ == "__main__":
    main()
