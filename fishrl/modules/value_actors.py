"""Policies of value-based algorithms: action values, LSTM, epsilon-greedy."""

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import EGreedyModule, LSTMModule, QValueModule

from fishrl.modules.actors import make_mlp
from fishrl.settings import checked

#: Keys of the LSTM state; the network writes the new state under ``("next", key)``.
MEMORY = ("recurrent_state_h", "recurrent_state_c")


@checked
def make_value_actor(
    *,
    num_inputs: int,
    num_actions: int,
    hidden: Sequence[int] = (256, 256),
    generator: torch.Generator | None = None,
) -> TensorDictSequential:
    """Build a network of action values with a greedy policy over the legal actions.

    Inputs and arguments are those of ``make_actor``. Writes ``action_value`` ``[..., num_actions]``
    (the most negative float for illegal actions), the integer ``action`` ``[...]`` and its
    ``chosen_action_value`` ``[..., 1]``.
    """
    network = make_mlp([num_inputs, *hidden, num_actions], generator=generator)
    return TensorDictSequential(
        TensorDictModule(network, in_keys=["observation_stack"], out_keys=["action_value"]),
        QValueModule("categorical", action_mask_key="action_mask"),
    )


@checked
def make_recurrent_value_actor(
    *,
    num_inputs: int,
    num_actions: int,
    hidden: Sequence[int] = (256, 256),
    generator: torch.Generator | None = None,
) -> TensorDictSequential:
    """Build a network of action values whose last hidden layer is an LSTM.

    Reads one ``observation`` ``[..., num_inputs]``, ``action_mask``, the LSTM state ``MEMORY``
    ``[..., 1, hidden[-1]]`` and ``is_init`` ``[..., 1]``, which resets that state. Writes the new
    state under ``next`` and the outputs of ``make_value_actor``.

    Raises:
        ValueError: if there is no hidden layer.
    """
    if not hidden:
        raise ValueError(f"hidden = {list(hidden)}: must have at least one width, for the LSTM")
    *before, size = hidden
    layers: list[TensorDictModuleBase] = []
    if before:
        encoder = make_mlp([num_inputs, *before], generator=generator)
        layers.append(
            TensorDictModule(
                nn.Sequential(encoder, nn.ReLU()), in_keys=["observation"], out_keys=["seen"]
            )
        )
    with torch.random.fork_rng(devices=[], enabled=generator is not None):
        memory = LSTMModule(
            input_size=before[-1] if before else num_inputs,
            hidden_size=size,
            in_keys=["seen" if before else "observation", *MEMORY],
            out_keys=["remembered", *(("next", key) for key in MEMORY)],
        )
    with torch.no_grad():
        for weight in memory.parameters():  # the distribution of nn.LSTM
            weight.uniform_(-1.0 / math.sqrt(size), 1.0 / math.sqrt(size), generator=generator)
    head = make_mlp([size, num_actions], generator=generator)
    return TensorDictSequential(
        *layers,
        memory,
        TensorDictModule(head, in_keys=["remembered"], out_keys=["action_value"]),
        QValueModule("categorical", action_mask_key="action_mask"),
    )


class RecurrentPolicy(TensorDictModuleBase):
    """Recurrent policy that keeps its LSTM state between calls, for evaluation.

    ``is_init`` resets the state of a row, a new batch size the state of all rows. To collect
    transitions for a replay buffer, use ``network`` in an environment with the transform of
    ``torchrl.modules.get_primers_from_module``, which stores the state with the observation.

    Args:
        network: see ``make_recurrent_value_actor``.
    """

    def __init__(self, network: TensorDictSequential) -> None:
        super().__init__()
        self.network = network
        self.in_keys = [key for key in network.in_keys if key not in MEMORY]
        self.out_keys = ["action"]
        self._memory: dict[str, Tensor] = {}

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action`` ``[B]``."""
        seen = TensorDict(
            {key: tensordict[key] for key in self.in_keys}, batch_size=tensordict.batch_size
        )
        if all(value.shape[:-2] == seen.batch_size for value in self._memory.values()):
            seen.update(self._memory)
        after = self.network(seen)
        self._memory = {key: after["next", key].detach() for key in MEMORY}
        return tensordict.set("action", after["action"])


class EpsilonGreedy(EGreedyModule):
    """Epsilon-greedy exploration: replace a decaying share of actions by random legal ones.

    Append it to a greedy policy. It is inactive under ``ExplorationType.DETERMINISTIC``. Arguments
    are those of TorchRL's module; ``eps`` decays with each decision, without calls of ``step``.
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Replace a share ``eps`` of the actions ``[B]`` and advance the decay."""
        tensordict = super().forward(tensordict)
        if exploration_type() in (ExplorationType.RANDOM, None):
            self.step(tensordict.numel())
        return tensordict
