"""Actors and critics for discrete and continuous actions."""

import itertools
import math
from collections.abc import Sequence

import torch
from tensordict.nn import InteractionType, TensorDictModule
from torch import Tensor, nn
from torchrl.data import Bounded, Categorical
from torchrl.modules import MaskedCategorical, NormalParamExtractor, ProbabilisticActor, TanhNormal

from fishrl.settings import checked

#: Logit of illegal actions. exp(-1e9) is exactly 0 in float32 and bfloat16, and the logit stays
#: finite in the loss, where an infinite one would give 0 * inf.
ILLEGAL_LOGIT = -1e9


@checked
def make_mlp(
    widths: Sequence[int], *, is_normed: bool = False, generator: torch.Generator | None = None
) -> nn.Sequential:
    """Build a fully connected network of layer ``widths`` with ReLU between its layers.

    ``is_normed`` adds layer normalisation before each ReLU (Ba et al. 2016, arXiv 1607.06450).
    ``generator`` (by default the global one) draws weights with the distribution of ``nn.Linear``.

    Raises:
        ValueError: if a width is smaller than 1.
    """
    if min(widths) < 1:
        raise ValueError(f"layer widths = {list(widths)}: must be at least 1")
    layers: list[nn.Module] = []
    for fan_in, fan_out in itertools.pairwise(widths):
        with torch.random.fork_rng(devices=[], enabled=generator is not None):
            linear = nn.Linear(fan_in, fan_out)
        bound = 1.0 / math.sqrt(fan_in)
        nn.init.uniform_(linear.weight, -bound, bound, generator=generator)
        nn.init.uniform_(linear.bias, -bound, bound, generator=generator)
        norm = [nn.LayerNorm(fan_out)] if is_normed else []
        layers += [linear, *norm, nn.ReLU()]
    return nn.Sequential(*layers[: layers.index(linear) + 1])


@checked
def make_actor(
    *,
    num_inputs: int,
    num_actions: int,
    hidden: Sequence[int] = (256, 256),
    return_log_prob: bool = False,
    generator: torch.Generator | None = None,
) -> ProbabilisticActor:
    """Build a softmax policy over the legal actions.

    Reads ``observation_stack`` ``[..., num_inputs]`` and ``action_mask`` ``[..., num_actions]``
    (bool), writes ``logits`` ``[..., num_actions]`` and the integer ``action`` ``[...]``. Under
    ``ExplorationType.DETERMINISTIC`` the action is the most probable legal one, otherwise a sample.

    Args:
        num_inputs: size of the stacked observation.
        num_actions: number of actions, legal or not.
        hidden: widths of the hidden layers.
        return_log_prob: also write ``action_log_prob`` ``[...]``, which ``ClipPPOLoss`` reads.
        generator: draws the initial weights.
    """
    network = make_mlp([num_inputs, *hidden, num_actions], generator=generator)
    return ProbabilisticActor(
        module=TensorDictModule(network, in_keys=["observation_stack"], out_keys=["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask"},
        out_keys=["action"],
        spec=Categorical(num_actions),
        distribution_class=MaskedCategorical,
        distribution_kwargs={"neg_inf": ILLEGAL_LOGIT},
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=return_log_prob,
    )


class _JoinedInputs(nn.Sequential):
    """A network that concatenates its inputs ``[..., n_i]``."""

    def forward(self, *inputs: Tensor) -> Tensor:
        joined: Tensor = super().forward(torch.cat(inputs, -1))  # type: ignore[no-untyped-call]
        return joined


def _read(keys: Sequence[str], network: nn.Module, written: str) -> TensorDictModule:
    """Return a network of one entry, or of several concatenated ones."""
    network = network if len(keys) == 1 else _JoinedInputs(network)
    return TensorDictModule(network, in_keys=list(keys), out_keys=[written])


@checked
def make_twin_critics(
    *,
    num_inputs: int,
    num_actions: int,
    hidden: Sequence[int] = (256, 256),
    keys: Sequence[str] = ("observation_stack",),
    reads_action: bool = False,
    is_normed: bool = False,
    generator: torch.Generator | None = None,
) -> list[TensorDictModule]:
    """Build two independent critics.

    Each reads ``keys``, with ``num_inputs`` numbers in all, and writes ``action_value``
    ``[..., num_actions]``, also of illegal actions, to which the policy gives probability 0. With
    ``reads_action`` each also reads the continuous ``action`` ``[..., num_actions]``, and writes
    ``state_action_value`` ``[..., 1]``. With ``is_normed`` they have layer normalisation. Other
    arguments are those of ``make_actor``. The result is a list because TorchRL's loss resamples the
    weights of a single critic that it duplicates.
    """
    widths, written = [num_inputs, *hidden, num_actions], "action_value"
    if reads_action:
        widths, written = [num_inputs + num_actions, *hidden, 1], "state_action_value"
        keys = [*keys, "action"]
    networks = (make_mlp(widths, is_normed=is_normed, generator=generator) for _ in range(2))
    return [_read(keys, network, written) for network in networks]


@checked
def make_continuous_actor(
    *,
    num_inputs: int,
    num_actions: int,
    hidden: Sequence[int] = (256, 256),
    return_log_prob: bool = False,
    generator: torch.Generator | None = None,
) -> ProbabilisticActor:
    """Build a tanh-normal policy of ``num_actions`` numbers in [-1, 1].

    Reads ``observation_stack`` ``[..., num_inputs]``, writes ``loc`` and ``scale`` of the normal
    distribution and ``action``, each ``[..., num_actions]``. Under
    ``ExplorationType.DETERMINISTIC`` the action is tanh(loc), otherwise a sample. Arguments are
    those of ``make_actor``.
    """
    network = make_mlp([num_inputs, *hidden, 2 * num_actions], generator=generator)
    return ProbabilisticActor(
        module=TensorDictModule(
            nn.Sequential(network, NormalParamExtractor()),
            in_keys=["observation_stack"],
            out_keys=["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        out_keys=["action"],
        spec=Bounded(-1.0, 1.0, shape=(num_actions,)),
        distribution_class=TanhNormal,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=return_log_prob,
    )


@checked
def make_state_critic(
    *,
    num_inputs: int,
    hidden: Sequence[int] = (256, 256),
    keys: Sequence[str] = ("observation_stack",),
    generator: torch.Generator | None = None,
) -> TensorDictModule:
    """Build a critic that reads ``keys`` and writes ``state_value`` ``[..., 1]``."""
    return _read(keys, make_mlp([num_inputs, *hidden, 1], generator=generator), "state_value")
