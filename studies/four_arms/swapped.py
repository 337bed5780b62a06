"""A fish with the lateral line of another episode: ``python studies/four_arms/swapped.py``.

``zoo/gait_bend_line`` from 24 starts for 40 T, in rows of twelve, each with the neuromasts of the
row above it: the right statistics, and nothing of its own vortices.
"""

from dataclasses import replace

import torch
from tensordict import TensorDictBase
from torch import nn

from fishrl.envs import KarmanGait
from fishrl.programs.statistics import find_share
from fishrl.training import evaluate
from fishrl.zoo import load_policy


class Swapped(nn.Module):
    """A policy whose rows see the lateral lines of their neighbours, and else what is theirs."""

    def __init__(self, policy: nn.Module, task: KarmanGait) -> None:
        super().__init__()
        own = replace(task, observes=task.observes[: task.observes.index("lateral_line")])
        self.policy, self.num_stacked, self.num_own = policy, task.num_stacked, own.n_obs

    def forward(self, state: TensorDictBase) -> TensorDictBase:
        """Return ``state`` with the action that the neighbours' neuromasts suggest."""
        stack = state["observation_stack"].unflatten(-1, (self.num_stacked, -1))
        own, line = stack[..., : self.num_own], stack[..., self.num_own :].roll(1, 0)
        seen = state.clone(recurse=False)
        seen["observation_stack"] = torch.cat((own, line), -1).flatten(1)
        return state.set("action", self.policy(seen)["action"])


def main() -> None:
    """Print how long the fish lasts as taught, and with the lateral line of another episode."""
    policy, task = load_policy("gait_bend_line")
    assert isinstance(task, KarmanGait) and task.observes[-1] == "lateral_line"
    task = replace(task, time_limit=321)
    for name, acting in (("its own", policy), ("another's", Swapped(policy, task))):
        result = evaluate(acting, task=task, episodes=24, num_envs=12)
        share = find_share(round(24 * result["success_rate"]), 24).show(".0%")
        print(f"{name}: lasts 40 T in {share}, {result['mean_length_T']:.1f} T on average")


if __name__ == "__main__":
    main()
