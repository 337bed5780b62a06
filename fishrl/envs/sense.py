"""Senses: the parts of an observation."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.settings import suggest


class Sense(NamedTuple):
    """A part of the observation."""

    name: str  #: such as "place of the food"
    numbers: tuple[str, ...]  #: name and unit of each of its numbers, such as "x [L]"
    read: Callable[[TensorDictBase], Tensor]  #: returns them, ``[B, n]``, from a measurement
    #: its mirror image, see ``mirror.Mirror``: (1, -2) of a place (x, y); None if it has none
    mirror: tuple[int, ...] | None = None


def choose_critic_senses(names: Sequence[str], known: Mapping[str, Sense]) -> tuple[Sense, ...]:
    """Return the senses that critics read, by their names.

    Raises:
        ValueError: for an unknown name, and for a sense that has no numbers, as flow labels.
    """
    allowed = [name for name, sense in known.items() if sense.numbers]
    for name in names:
        if not allowed:
            raise ValueError(
                f"critic_observes = {names}: the task lists no senses; define its critic_senses"
            )
        if name not in allowed:
            raise ValueError(
                f"critic_observes = {names}: allowed are {', '.join(allowed)}"
                f"{suggest(name, allowed)}"
            )
    return tuple(known[name] for name in names)


def read_senses(senses: Sequence[Sense], now: TensorDictBase) -> Tensor:
    """Return the numbers of senses ``[B, n]``, float32, from a measurement."""
    return torch.cat([sense.read(now).float() for sense in senses], -1)


def count_numbers(senses: Sequence[Sense]) -> int:
    """Return how many numbers senses have."""
    return sum(len(sense.numbers) for sense in senses)
