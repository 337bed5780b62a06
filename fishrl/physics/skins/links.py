"""Links of the lattice that a body's outline cuts.

The outline is the closed polygon of the markers. Its segments are shorter than the lines of the
lattice are apart, so each crosses at most one line of each of the four families (x, y and the two
diagonals): N markers give 4 N possible links in arrays of fixed shape, without a search.
"""

from typing import NamedTuple

import torch
from torch import Tensor

# along x, along y and the two diagonals: (direction with the line, against it), and that with it
_FAMILIES = ((1, 3), (2, 4), (5, 7), (8, 6))
_ALONG = ((1, 0), (0, 1), (1, 1), (1, -1))
#: Longest segment, nodes: the diagonals lie 0.707 apart, and a gait stretches the outline.
MAX_SPACING = 0.55
#: Distance of an outline from the edge nodes at which all that is read around its links is on the
#: grid: the node outside, the next one, and that one's neighbours.
MARGIN = 2.0


class Links(NamedTuple):
    """Links that an outline cuts; ``[B, 4, N]``, one row per family of lattice lines."""

    is_cut: Tensor  #: whether the segment from marker n to the next crosses a line of the family
    x: Tensor  #: node outside, int64
    y: Tensor  #: node outside, int64
    cx: Tensor  #: int64, direction from there into the body
    cy: Tensor  #: int64, the same along y
    q: Tensor  #: int64, its number
    back: Tensor  #: int64, the number of the opposite direction
    fraction: Tensor  #: part of the link outside the body, 0 to 1
    at: Tensor  #: place of the crossing on the segment, 0 to 1


def find_links(outline: Tensor, width: int, height: int) -> Links:
    """Return the links that a clockwise closed polygon ``[B, N, 2]`` cuts, in nodes.

    Neighbouring segments round their common corner alike, so no link is missed or found twice.
    Nodes are clamped to the grid, two nodes from its edges, for bodies that have left it.
    """
    after = torch.cat((outline[:, 1:], outline[:, :1]), 1)  # ``roll`` compiles for 4 s longer
    (xa, ya), (xb, yb) = outline.unbind(-1), after.unbind(-1)
    level_a, level_b = (torch.stack((y, x, x - y, x + y), 1) for x, y in ((xa, ya), (xb, yb)))
    place_a, place_b = (torch.stack((x, y, x, x), 1) for x, y in ((xa, ya), (xb, yb)))
    floor_a, floor_b = level_a.floor(), level_b.floor()
    is_cut = floor_a != floor_b
    level = torch.maximum(floor_a, floor_b)
    at = ((level - level_a) / torch.where(is_cut, level_b - level_a, 1.0)).clamp(0.0, 1.0)
    place = place_a + at * (place_b - place_a)
    # outward normal (ya - yb, xb - xa) along each family's line
    nx, ny = ya - yb, xb - xa
    faces = torch.stack((nx, ny, nx + ny, nx - ny), 1) > 0.0
    node = place.floor() + faces
    sides = list(zip(faces.unbind(1), _FAMILIES, _ALONG, strict=True))
    (n0, n1, n2, n3), (m0, m1, m2, m3) = node.unbind(1), level.unbind(1)
    x, y = torch.stack((n0, m1, n2, n3), 1), torch.stack((m0, n1, n2 - m2, m3 - n3), 1)
    return Links(
        is_cut=is_cut,
        x=x.nan_to_num(0.0).clamp(2.0, width - 3.0).long(),
        y=y.nan_to_num(0.0).clamp(2.0, height - 3.0).long(),
        cx=torch.stack([torch.where(side, -along[0], along[0]) for side, _, along in sides], 1),
        cy=torch.stack([torch.where(side, -along[1], along[1]) for side, _, along in sides], 1),
        q=torch.stack([torch.where(side, own[1], own[0]) for side, own, _ in sides], 1),
        back=torch.stack([torch.where(side, own[0], own[1]) for side, own, _ in sides], 1),
        fraction=(node - place).abs(),
        at=at,
    )


class Passed(NamedTuple):
    """The node that each segment of an outline may have passed in a step, ``[B, N]``."""

    x: Tensor  #: int64
    y: Tensor  #: int64
    turns: Tensor  #: int32, 1 where the segment has covered the node, -1 where it uncovered it
    cx: Tensor  #: int64, from an uncovered node to the next one outside; zero elsewhere
    cy: Tensor  #: int64, the same along y
    at: Tensor  #: place of the segment next to the node, 0 to 1


def find_passed(before: Tensor, now: Tensor, width: int, height: int) -> Passed:
    """Return the nodes that a clockwise closed polygon ``[B, N, 2]`` has passed between two places.

    A segment sweeps the quadrilateral between its two places, smaller than the distance of two
    nodes. How often it winds around a node, summed over all segments, is the change of how often
    the polygon does: each node that changes sides is found once.
    """
    ends = [torch.cat((outline[:, 1:], outline[:, :1]), 1) for outline in (before, now)]
    corners = [corner.unbind(-1) for corner in (before, *ends, now)]
    sides = list(zip(corners, (*corners[1:], corners[0]), strict=True))
    x, y = (
        (0.25 * sum(parts[1:], parts[0])).round().nan_to_num(0.0).clamp(2.0, size - 3.0)
        for parts, size in zip(zip(*corners, strict=True), (width, height), strict=True)
    )
    turns = torch.zeros_like(x, dtype=torch.int32)
    for (xa, ya), (xb, yb) in sides:
        left = (xb - xa) * (y - ya) - (x - xa) * (yb - ya)
        turns = turns + ((ya <= y) & (y < yb) & (left > 0.0)).int()
        turns = turns - ((yb <= y) & (y < ya) & (left < 0.0)).int()
    (xb, yb), (xa, ya) = corners[2:]
    along_x, along_y = xb - xa, yb - ya
    square = (along_x * along_x + along_y * along_y).clamp_min(1e-12)
    is_steep, is_new = along_y.abs() >= along_x.abs(), turns < 0
    return Passed(
        x=x.long(),
        y=y.long(),
        turns=turns,
        cx=torch.where(is_new & is_steep, -along_y.sign(), 0.0).long(),
        cy=torch.where(is_new & ~is_steep, along_x.sign(), 0.0).long(),
        at=(((x - xa) * along_x + (y - ya) * along_y) / square).clamp(0.0, 1.0),
    )


def to_links(values: Tensor, links: Links) -> Tensor:
    """Interpolate values ``[B, N]`` of the markers to the crossings, ``[B, 4, N]``."""
    here, after = values[:, None], values.roll(-1, -1)[:, None]
    return here + links.at.to(values) * (after - here)


def to_markers(values: Tensor, links: Links) -> Tensor:
    """Share values ``[B, 4, N]`` at crossings among the markers, ``[B, N]``.

    The adjoint of ``to_links``: forces keep their torque and their power.
    """
    share = links.at.to(values) * values
    return (values - share).sum(1) + share.sum(1).roll(1, -1)
