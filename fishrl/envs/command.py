"""What a task commands a fish to do until the next decision."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from torch import Tensor


class Command(NamedTuple):
    """Command to the body for one control interval; commands to M fish are ``[B, M]``."""

    #: ``[B]`` change of heading in radians, positive to the left (counter-clockwise), spread
    #: smoothly over the interval; None for straight ahead
    turn: Tensor | None = None
    #: ``[B]`` deflection of the tail in L, positive for a turn to the left, of a fish whose motion
    #: is ``Bending()``; None for none
    bend: Tensor | None = None
    frequency: Tensor | None = None  #: ``[B]`` tail beats per step, or None to keep it
    #: ``[B]`` share of the gait's amplitude, 0 to 1, or None to keep it
    amplitude: Tensor | None = None
    #: entries ``[B, ...]`` of ``HasHistory.begin`` for the next measurement
    kept: Mapping[str, Tensor] = MappingProxyType({})
