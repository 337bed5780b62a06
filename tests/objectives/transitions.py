"""Random transitions with action masks, for the losses."""

import torch
from tensordict import TensorDict

NUM_ACTIONS, NUM_INPUTS = 4, 6


def make_transitions(
    num: int = 64, *, is_all_legal: bool = False, key: str = "observation_stack"
) -> TensorDict:
    """Return transitions ``[num]``, a fifth terminated and a fifth truncated."""
    generator = torch.Generator().manual_seed(3)

    def draw_mask() -> torch.Tensor:
        mask = torch.rand(num, NUM_ACTIONS, generator=generator) > 0.5
        mask[torch.arange(num), torch.randint(NUM_ACTIONS, (num,), generator=generator)] = True
        return torch.ones_like(mask) if is_all_legal else mask

    mask, next_mask = draw_mask(), draw_mask()
    terminated = torch.rand(num, 1, generator=generator) < 0.2
    truncated = torch.rand(num, 1, generator=generator) < 0.2
    following = {
        key: torch.randn(num, NUM_INPUTS, generator=generator),
        "action_mask": next_mask,
        "reward": torch.randn(num, 1, generator=generator),
        "done": terminated | truncated,
        "terminated": terminated,
    }
    return TensorDict(
        {
            key: torch.randn(num, NUM_INPUTS, generator=generator),
            "action_mask": mask,
            "action": torch.multinomial(mask.float(), 1, generator=generator).squeeze(-1),
            "next": TensorDict(following, [num]),
        },
        [num],
    )
