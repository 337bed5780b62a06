"""Where the grid is finer: settings of patches, and their sizes on each level."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, floor
from typing import Annotated, Self

from pydantic import Field, NonNegativeInt

from fishrl.physics.bodies.outline import BodyConfig
from fishrl.settings import Settings

#: Nodes of the parent that a patch keeps from its parent's edges. Fewer read what is not there.
CLEARANCE = 2
#: Layers of a patch that its parent fills; a skin must read further inside.
RING = 2
#: Least distance of a body, or of the next finer patch, from the edges of a patch, in body lengths
#: and in nodes of the parent: half of it still gives the speed of a swimmer within 0.1 %.
MARGIN_BL, MARGIN_NODES = 0.25, 8

#: A smaller patch has no node that its parent takes.
LEAST_SIDE = 8
Side = Annotated[float, Field(ge=LEAST_SIDE)]

Point = tuple[float, float]
#: First and last node (x, y) of the coarsest level that patches may cover.
Bounds = tuple[tuple[int, int], tuple[int, int]]


class Patch(Settings):
    """Where a flow with ``levels`` is fine: around a body, which it follows, or where it stays.

    On each coarser level the patch is larger by its margin on each side: eight nodes of the next
    coarser level, or if that is more, and it follows, a quarter of the first body's length. Lengths
    are in nodes of the finest level. A patch that stays ends before edges and sponges. One that
    follows moves by 2^(2 - levels) nodes per step at most: with five, a body of 0.15 leaves it.

    Args:
        bodies: those inside, by their number; None is all. It follows the first if it moves.
        size: (width, height) of the finest level; None is a square that holds the first body at
            any heading, with the margin all round.
        centre: (x, y) of a patch that stays; None follows.
        within: two corners (x, y) of a box that a patch which follows does not leave, so that it
            never meets another; its bodies must not either. None is all water.
    """

    bodies: tuple[NonNegativeInt, ...] | None = (0,)
    size: tuple[Side, Side] | None = None
    centre: Point | None = None
    within: tuple[Point, Point] | None = None

    def __post_init__(self) -> None:
        if self.within is not None and self.centre is not None:
            raise ValueError("a Patch with a centre stays there: leave within out, or the centre")
        if self.bodies == () and (self.size is None or self.centre is None):
            raise ValueError("a Patch without bodies needs both size and centre")

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the bodies inside, once ``fit_patch`` has listed them."""
        return self.bodies or ()

    @classmethod
    def between(cls, low: tuple[float, float], high: tuple[float, float]) -> Self:
        """Return a patch that stays between two corners (x, y) and holds all bodies."""
        (left, bottom), (right, top) = low, high
        centre = 0.5 * (left + right), 0.5 * (bottom + top)
        return cls(bodies=None, size=(right - left, top - bottom), centre=centre)


def inset(level: int, num_levels: int) -> int:
    """Return how far a patch's grid keeps from that of the coarsest patch, finest nodes.

    ``level`` counts from the finest, 0.
    """
    return int(CLEARANCE * (2 ** (num_levels - 1) - 2 ** (level + 1))) if num_levels > 1 else 0


def fit_patch(patch: Patch, num_bodies: int, num_levels: int, bounds: Bounds) -> Patch:
    """Return a patch with the numbers of its bodies; if it stays, cut off at ``bounds``."""
    patch = replace(
        patch, bodies=tuple(range(num_bodies)) if patch.bodies is None else patch.bodies
    )
    if patch.centre is None:
        return patch
    unit, least = 2 ** (num_levels - 1), inset(0, num_levels)
    sides, given = [], patch.size or (LEAST_SIDE, LEAST_SIDE)
    for at, size, first, last in zip(patch.centre, given, *bounds, strict=True):
        ends = max(at - 0.5 * size, unit * first + least), min(at + 0.5 * size, unit * last - least)
        if ends[1] - ends[0] < LEAST_SIDE:
            raise ValueError(
                f"{patch}: less than {LEAST_SIDE} of its nodes lie in {unit * first + least} to "
                f"{unit * last - least}, away from edges and sponges: move it in, or enlarge the "
                "domain"
            )
        sides.append(ends)
    if patch.size is None:
        return patch
    (left, right), (bottom, top) = sides
    return replace(Patch.between((left, bottom), (right, top)), bodies=patch.bodies)


def find_room(patch: Patch, num_levels: int, bounds: Bounds) -> Bounds:
    """Return the part of ``bounds`` that a patch may cover."""
    if patch.within is None:
        return bounds
    unit, (first, last) = 2 ** (num_levels - 1), patch.within
    (left, bottom), (right, top) = bounds
    return (
        (max(left, ceil(first[0] / unit)), max(bottom, ceil(first[1] / unit))),
        (min(right, floor(last[0] / unit)), min(top, floor(last[1] / unit))),
    )


def measure_patch(
    patch: Patch, bodies: Sequence[BodyConfig], num_levels: int, bounds: Bounds
) -> list[tuple[int, int]]:
    """Return (width, height) in its own nodes on each level but the root, coarsest first.

    ``patch`` is as ``fit_patch`` returns it. What stays takes the margin that there is.
    """
    length = bodies[patch.numbers[0]].size if patch.bodies else 0.0
    if patch.size is None:
        side = length + 2.0 * max(MARGIN_BL * length, 2.0 * MARGIN_NODES)
        width, height = side, side
    else:
        width, height = patch.size
    stays, unit = patch.centre is not None, 2 ** (num_levels - 1)
    room = [unit * (last - first) for first, last in zip(*bounds, strict=True)]
    sizes = []
    for level in range(num_levels - 1):  # finest first
        spacing = 2**level
        if stays:
            most = [n - 2 * inset(level, num_levels) for n in room]
            width, height = min(width, most[0]), min(height, most[1])
        cells = ceil(width / (2 * spacing)), ceil(height / (2 * spacing))
        sizes.append((2 * cells[0] + 1, 2 * cells[1] + 1))
        margin = max(0.0 if stays else MARGIN_BL * length, 4.0 * MARGIN_NODES * spacing)
        width, height = (2 * spacing * n + 2.0 * margin for n in cells)
    return sizes[::-1]
