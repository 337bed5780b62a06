"""The twin critics: values of all actions in a state."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule

from fishrl.modules.actors import make_mlp_module


def make_twin_critics(
    *,
    num_inputs: int,
    num_actions: int,
    hidden: Sequence[int] = (256, 256),
    in_key: str = "observation_stack",
    generator: torch.Generator | None = None,
) -> list[TensorDictModule]:
    """Build two independent critics.

    Each reads ``in_key`` ``[..., num_inputs]`` and writes ``action_value`` ``[..., num_actions]``.
    They come as a list because TorchRL's loss resamples the weights of a single critic that it
    duplicates. Values of illegal actions are not masked: the policy gives them probability 0.

    Args and errors are those of ``fishrl.modules.make_actor``.
    """
    return [
        make_mlp_module(
            num_inputs=num_inputs,
            num_outputs=num_actions,
            hidden=hidden,
            in_key=in_key,
            out_key="action_value",
            generator=generator,
        )
        for _ in range(2)
    ]
