"""Counter-based random numbers: a hash of (seed, row, episode).

With a stateful generator, the numbers of one row would depend on when other rows end their
episodes. Here the starts of a row are the same in any batch.
"""

import torch
from torch import Tensor

#: Larger seeds lose their higher bits.
MAX_SEED = 0x7FFFFFFFFFFFFFFF
_GOLDEN = 0x9E3779B97F4A7C15 - (1 << 64)
_MIX_1 = 0xBF58476D1CE4E5B9 - (1 << 64)
_MIX_2 = 0x94D049BB133111EB - (1 << 64)


def scramble(x: Tensor) -> Tensor:
    """Mix the bits of int64 ``[...]`` as SplitMix64 does (Steele, Lea & Flood 2014)."""
    x = (x ^ _shift_right(x, 30)) * _MIX_1
    x = (x ^ _shift_right(x, 27)) * _MIX_2
    return x ^ _shift_right(x, 31)


def draw_uniform(seed: int | Tensor, row: Tensor, episode: Tensor, num: int) -> Tensor:
    """Draw ``[B, num]`` in [0, 1), float64, multiples of 2^-53, keyed on (seed, row, episode).

    Args:
        seed: seed of the environment, ``[B]`` or one for all.
        row: ``[B]`` int64, index of the row.
        episode: ``[B]`` int64, number of episodes that the row has begun.
        num: numbers per row.
    """
    key = torch.zeros_like(row) + (seed & MAX_SEED) + _GOLDEN
    for counter in (row, episode):
        key = scramble(key) ^ (counter + _GOLDEN)
    counters = torch.arange(1, num + 1, device=row.device)
    bits = scramble(scramble(key)[:, None] + counters * _GOLDEN)
    return _shift_right(bits, 11).double() * 2.0**-53


def _shift_right(x: Tensor, num_bits: int) -> Tensor:
    """Shift int64 as an unsigned integer."""
    return (x >> num_bits) & ((1 << (64 - num_bits)) - 1)
