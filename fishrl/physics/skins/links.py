"""Links of the lattice that outlines cut, and nodes that outlines pass.

An outline is the closed polygon of a body's markers. Those of all bodies follow each other in one
row of N markers; ``counts`` says how many are whose. Segments are shorter than the lines of the
lattice are apart, so each crosses at most one line of each of the four families (x, y and the two
diagonals): N markers give 4 N possible links in arrays of fixed shape, without a search.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.lattice import CX, CY, W

#: Directions with the lines of each family, and against them.
ALONG, AGAINST = (1, 2, 5, 8), (3, 4, 7, 6)
#: Longest segment, nodes: the diagonals lie 0.707 apart, and a gait stretches the outline.
MAX_SPACING = 0.55
#: Distance of an outline from the edge nodes at which all that is read around its links is on the
#: grid: the node outside, the next one, and that one's neighbours.
MARGIN = 2.0


class Families(NamedTuple):
    """The four families of lattice lines, ``[4, 1]`` each, float64."""

    cx: Tensor  #: direction with the line, 0 or 1
    cy: Tensor  #: the same along y
    level_x: Tensor  #: level_x x + level_y y counts the lines of the family
    level_y: Tensor
    w: Tensor  #: weight of its directions


def make_families(device: torch.device) -> Families:
    """Return the families of lattice lines."""
    cx, cy, w = ([values[q] for q in ALONG] for values in (CX, CY, W))
    table = [cx, cy, [0, 1, 1, 1], [1, 0, -1, 1], w]
    return Families(*torch.tensor(table, dtype=torch.float64, device=device)[..., None].unbind())


class Links(NamedTuple):
    """Links that outlines cut; ``[B, 4, N]``, one row per family of lattice lines."""

    #: 1 where the segment from marker n to the next crosses a line of the family and the body lies
    #: along it, -1 where the body lies against it, 0 where the segment crosses none
    sign: Tensor
    x: Tensor  #: node outside, int32
    y: Tensor  #: node outside, int32
    fraction: Tensor  #: part of the link outside the body, 0 to 1
    at: Tensor  #: place of the crossing on the segment, 0 to 1


def find_links(
    outlines: Tensor,
    counts: Sequence[int],
    size: tuple[int, int],
    families: Families,
    dtype: torch.dtype,
) -> Links:
    """Return the links, of ``dtype``, that clockwise closed polygons ``[B, N, 2]`` cut, in nodes.

    Neighbouring segments round their common corner alike, so no link is missed or found twice.
    Nodes are clamped to a grid of ``size`` (width, height), two nodes from its edges, for bodies
    that have left it.
    """
    cx, cy, level_x, level_y, _ = families
    (xa, ya), (xb, yb) = (corners[:, :, None].unbind(1) for corners in _list_ends(outlines, counts))
    level_a, level_b = level_x * xa + level_y * ya, level_x * xb + level_y * yb
    place_a, place_b = cx * xa + (1.0 - cx) * ya, cx * xb + (1.0 - cx) * yb
    floor_a, floor_b = level_a.floor(), level_b.floor()
    is_cut = floor_a != floor_b
    level = torch.maximum(floor_a, floor_b)
    at = ((level - level_a) / torch.where(is_cut, level_b - level_a, 1.0)).clamp(0.0, 1.0)
    place = place_a + at * (place_b - place_a)
    # the outward normal (ya - yb, xb - xa) along the line says on which side the body is
    is_outside = cx * (ya - yb) + cy * (xb - xa) > 0.0
    node = place.floor() + torch.where(is_outside, 1.0, 0.0)
    return Links(
        sign=torch.where(is_cut, torch.where(is_outside, -1.0, 1.0), 0.0).to(dtype),
        x=_to_grid(cx * node + (1.0 - cx) * level, size[0]),
        y=_to_grid(cy * node + level_y * level, size[1]),
        fraction=(node - place).abs().to(dtype),
        at=at.to(dtype),
    )


class Passed(NamedTuple):
    """The node that each segment of outlines may have passed in a step, ``[B, N]``."""

    x: Tensor  #: int32
    y: Tensor  #: int32
    turns: Tensor  #: 1 where the segment has covered the node, -1 where it uncovered it
    cx: Tensor  #: from an uncovered node to the next one outside; zero elsewhere
    cy: Tensor  #: the same along y
    at: Tensor  #: place of the segment next to the node, 0 to 1


def find_passed(
    before: Tensor, now: Tensor, counts: Sequence[int], size: tuple[int, int], dtype: torch.dtype
) -> Passed:
    """Return the nodes that clockwise closed polygons ``[B, N, 2]`` passed between two places.

    A segment sweeps the quadrilateral between its two places, smaller than the distance of two
    nodes. How often it winds around a node, summed over all segments, is the change of how often
    the polygon does: each node that changes sides is found once.
    """
    (first, second), (fourth, third) = _list_ends(before, counts), _list_ends(now, counts)
    corners = [corner.unbind(1) for corner in (first, second, third, fourth)]
    middle = (0.25 * (first + second + third + fourth)).round()
    x, y = middle.unbind(1)
    turns = torch.zeros_like(x)
    for (xa, ya), (xb, yb) in zip(corners, (*corners[1:], corners[0]), strict=True):
        left = (xb - xa) * (y - ya) - (x - xa) * (yb - ya)
        turns = turns + torch.where((ya <= y) & (y < yb) & (left > 0.0), 1.0, 0.0)
        turns = turns - torch.where((yb <= y) & (y < ya) & (left < 0.0), 1.0, 0.0)
    (xb, yb), (xa, ya) = corners[2:]
    along_x, along_y = xb - xa, yb - ya
    square = (along_x * along_x + along_y * along_y).clamp_min(1e-12)
    is_steep, is_new = along_y.abs() >= along_x.abs(), turns < 0.0
    return Passed(
        x=_to_grid(x, size[0]),
        y=_to_grid(y, size[1]),
        turns=turns.to(dtype),
        cx=torch.where(is_new & is_steep, -along_y.sign(), 0.0).to(dtype),
        cy=torch.where(is_new & ~is_steep, along_x.sign(), 0.0).to(dtype),
        at=(((x - xa) * along_x + (y - ya) * along_y) / square).clamp(0.0, 1.0).to(dtype),
    )


def _list_ends(outlines: Tensor, counts: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return both ends ``[B, 2, N]`` of each segment of outlines ``[B, N, 2]``."""
    return outlines.mT, follow(outlines.mT, counts)


def _to_grid(node: Tensor, num_nodes: int) -> Tensor:
    """Return int32 coordinates of nodes two nodes from the edges at least, of NaN as well."""
    inside = torch.where(node > 2.0, node, 2.0).clamp_max(num_nodes - 3.0)
    return inside.float().int()  # from float64 it would be done one by one


def follow(values: Tensor, counts: Sequence[int]) -> Tensor:
    """Return the values ``[..., N]`` at the next marker of the same outline."""
    each = values.split(list(counts), -1)  # ``roll`` compiles for 4 s longer
    return torch.cat([end for own in each for end in (own[..., 1:], own[..., :1])], -1)


def to_links(values: Tensor, links: Links, counts: Sequence[int]) -> Tensor:
    """Interpolate values ``[..., B, N]`` of the markers to the crossings, ``[..., B, 4, N]``."""
    here, after = values.unsqueeze(-2), follow(values, counts).unsqueeze(-2)
    return here + links.at.to(values) * (after - here)


def to_markers(values: Tensor, links: Links, counts: Sequence[int]) -> Tensor:
    """Share values ``[..., B, 4, N]`` at crossings among the markers, ``[..., B, N]``.

    The adjoint of ``to_links``: forces keep their torque and their power.
    """
    share = links.at.to(values) * values
    each = share.sum(-2).split(list(counts), -1)
    passed_on = torch.cat([end for own in each for end in (own[..., -1:], own[..., :-1])], -1)
    return (values - share).sum(-2) + passed_on
