"""Where the grid is finer: settings of patches, and their sizes on each level."""

from collections.abc import Sequence
from math import ceil
from typing import Annotated

from pydantic import Field, NonNegativeInt, PositiveFloat

from fishrl.physics.bodies.outline import BodyConfig
from fishrl.settings import Settings

#: Nodes of the parent that a patch keeps from its parent's edges. Fewer read what is not there.
CLEARANCE = 2
#: Layers of a patch that its parent fills; a skin must read further inside.
RING = 2
# Least distance of a body, or of the next finer patch, from the edges of a patch, in body lengths
# and in nodes of the parent: half of it still gives the speed of a swimmer within 0.1 %.
_MARGIN_BL, _MARGIN_NODES = 0.25, 8


class Patch(Settings):
    """Where a flow with ``levels`` is fine: around a body, which it follows, or where it stays.

    On each coarser level the patch is larger by its margin on each side, a quarter of the first
    body's length or eight nodes of the next coarser level, whichever is more. Lengths are in nodes
    of the finest level.

    Args:
        bodies: those inside, by their number; it follows the first if it moves.
        size: (width, height) of the finest level; None is a square that holds the first body at
            any heading, with the margin all round.
        centre: (x, y) of a patch that stays; None follows.
    """

    bodies: tuple[NonNegativeInt, ...] = (0,)
    size: tuple[PositiveFloat, PositiveFloat] | None = None
    centre: tuple[Annotated[float, Field()], Annotated[float, Field()]] | None = None

    def __post_init__(self) -> None:
        if not self.bodies and (self.size is None or self.centre is None):
            raise ValueError("a Patch without bodies needs both size and centre")


def default_patches(bodies: Sequence[BodyConfig]) -> tuple[Patch, ...]:
    """Return one patch around each body."""
    return tuple(Patch(bodies=(index,)) for index in range(len(bodies)))


def measure_patch(
    patch: Patch, bodies: Sequence[BodyConfig], num_levels: int
) -> list[tuple[int, int]]:
    """Return (width, height) in its own nodes on each level but the root, coarsest first."""
    length = bodies[patch.bodies[0]].size if patch.bodies else 0.0
    if patch.size is None:
        side = length + 2.0 * max(_MARGIN_BL * length, 2.0 * _MARGIN_NODES)
        width, height = side, side
    else:
        width, height = patch.size
    sizes = []
    for level in range(num_levels - 1):  # finest first
        spacing = 2**level
        cells = ceil(width / (2 * spacing)), ceil(height / (2 * spacing))
        sizes.append((2 * cells[0] + 1, 2 * cells[1] + 1))
        margin = max(_MARGIN_BL * length, 4.0 * _MARGIN_NODES * spacing)
        width, height = (2 * spacing * n + 2.0 * margin for n in cells)
    return sizes[::-1]
