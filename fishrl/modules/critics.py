"""The twin critics: the value of every action in a state."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModule

from fishrl.modules.actors import make_mlp


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
    A list, because the loss resamples the weights of a single critic that it is asked to double.
    Values of illegal actions are left as they are: the policy gives them no weight.

    Args:
        num_inputs: length of the stacked observation.
        num_actions: number of actions, legal or not.
        hidden: widths of the hidden layers.
        in_key: key of the stacked observation.
        generator: source of the initial weights.

    Raises:
        ValueError: if a width is smaller than 1.
    """
    return [
        TensorDictModule(
            make_mlp(
                num_inputs=num_inputs, num_outputs=num_actions, hidden=hidden, generator=generator
            ),
            in_keys=[in_key],
            out_keys=["action_value"],
        )
        for _ in range(2)
    ]
