"""Reflection of replayed transitions about the axis of the flow."""

from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from fishrl.envs.mirror import Mirror


class Reflection(nn.Module):
    """Replace half of the transitions of a batch, drawn at random, by their mirror images.

    The global generator draws them. Numbers that transforms append to an observation, such as flow
    labels, are their own mirror images.

    Args:
        mirror: mirror image of the task.
        stacks: entries, with their lengths and the numbers of stacked observations.
    """

    def __init__(self, mirror: Mirror, stacks: Mapping[str, tuple[int, int]]) -> None:
        super().__init__()
        self.stacks = list(stacks)
        self.register_buffer("action", torch.tensor(mirror.action))
        of_critics = {"critic_stack": mirror.critic_observation}
        for key, (length, num_stacked) in stacks.items():
            signed = torch.tensor(of_critics.get(key, mirror.observation), dtype=torch.int64)
            num = length // num_stacked
            signed = torch.cat((signed, torch.arange(len(signed), num) + 1))
            starts = num * torch.arange(num_stacked)[:, None]
            self.register_buffer(f"{key}_index", (signed.abs() - 1 + starts).flatten())
            self.register_buffer(f"{key}_sign", signed.sign().float().repeat(num_stacked))

    def _reflect(self, key: str, stack: Tensor) -> Tensor:
        index, sign = self.get_buffer(f"{key}_index"), self.get_buffer(f"{key}_sign")
        return stack[..., index] * sign

    def reflect(self, transitions: TensorDictBase) -> TensorDictBase:
        """Return the mirror images of transitions ``[N]``."""
        action, mirrored = self.get_buffer("action"), transitions.copy()
        places: Sequence[TensorDictBase] = (mirrored, mirrored["next"])
        for place in places:
            for key in self.stacks:
                if key in place:
                    place[key] = self._reflect(key, place[key])
            if "action_mask" in place:
                place["action_mask"] = place["action_mask"][..., action]
        taken = transitions["action"]
        mirrored["action"] = taken * action if taken.is_floating_point() else action[taken]
        return mirrored

    def forward(self, transitions: TensorDictBase) -> TensorDictBase:
        """Return transitions ``[N]``, half of them reflected."""
        rows = torch.rand(transitions.shape, device=self.get_buffer("action").device) < 0.5
        return transitions.where(~rows, self.reflect(transitions))
