"""Whether bodies lie apart from each other and within the grid: when placed, and as they move."""

from collections.abc import Sequence
from itertools import combinations

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics.bodies.outline import BodyParams
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import locate_markers

#: Smallest distance between markers of two bodies, nodes.
MIN_GAP = 1.0


def check_number(config: FlowConfig, states: Sequence[BodyState]) -> None:
    """Raise ValueError unless there are as many bodies as in the configuration."""
    if len(states) != len(config.bodies):
        raise ValueError(
            f"the state has {len(states)} bodies, the config {len(config.bodies)}: give "
            "FlowConfig(bodies=...) and FlowState(f, bodies) the same number"
        )


@torch.no_grad()
def check_placement(
    config: FlowConfig, params: Sequence[BodyParams], states: Sequence[BodyState], rows: Tensor
) -> None:
    """Raise ValueError if bodies of the flows in ``rows`` ``[B]`` overlap or leave the grid.

    It names the first flow and bodies that are misplaced. For set-up: it reads its result on the
    host, which waits for a GPU. A graph that repeats it does not.
    """
    if rows.is_cuda and torch.cuda.is_current_stream_capturing():
        return
    check_number(config, states)
    names = [f"{index} ({type(body).__name__})" for index, body in enumerate(config.bodies)]
    chosen = rows.nonzero()[:, 0]
    params, states = pytree.tree_map(lambda t: t[chosen], (list(params), list(states)))
    outlines = [locate_markers(*body) for body in zip(params, states, strict=True)]
    for name, outline in zip(names, outlines, strict=True):
        _require(
            chosen,
            lies_inside(outline, config),
            f"body {name} reaches beyond the grid: {describe_inside(config)}",
        )
    for (name, one), (other_name, other) in combinations(zip(names, outlines, strict=True), 2):
        _require(
            chosen,
            ~do_overlap(one, other),
            f"bodies {name} and {other_name} overlap: move them apart, at least {MIN_GAP:g} node "
            "between their markers",
        )


def spread_starts(
    position: Tensor | None,
    heading: Tensor | None,
    config: FlowConfig,
    num_envs: int,
    device: torch.device,
) -> tuple[Tensor, Tensor]:
    """Return positions ``[B, M, 2]`` and headings ``[B, M]`` of all bodies, float64."""
    shape = num_envs, max(1, len(config.bodies))
    middle = torch.tensor([0.5 * config.width, 0.5 * config.height]).expand(*shape, 2)
    position = middle if position is None else position
    heading = torch.zeros(shape) if heading is None else heading
    got = tuple(position.shape), tuple(heading.shape)
    position, heading = position.to(device, torch.float64), heading.to(device, torch.float64)
    if shape[1] == 1:
        position, heading = position.reshape(-1, 1, 2), heading.reshape(-1, 1)
    if position.shape != (*shape, 2) or heading.shape != shape:
        raise ValueError(
            f"position and heading have shapes {got[0]} and {got[1]}: give {(*shape, 2)} and "
            f"{shape}, one for each of the {shape[1]} bodies in {num_envs} flows"
        )
    return position, heading


def describe_inside(config: FlowConfig) -> str:
    """Return where ``lies_inside`` wants the markers of a body, as a remedy."""
    (left, bottom), (right, top) = config.body_bounds
    return (
        f"keep its markers within x = {left:g} to {right:g} and y = {bottom:g} to {top:g}, "
        "as bodies cross no edge, periodic ones included"
    )


def lies_inside(outline: Tensor, config: FlowConfig) -> Tensor:
    """Return ``[B]`` bool: whether the markers ``[B, N, 2]`` of a body reach the grid alone."""
    (left, bottom), (right, top) = config.body_bounds
    x, y = outline.unbind(-1)
    return ((x > left) & (x < right) & (y > bottom) & (y < top)).all(-1)


def do_overlap(one: Tensor, other: Tensor) -> Tensor:
    """Return ``[B]`` bool: whether closed outlines ``[B, N, 2]`` touch or contain each other."""
    is_near = (torch.cdist(one, other) < MIN_GAP).flatten(1).any(-1)
    return is_near | _contains(one, other).any(-1) | _contains(other, one).any(-1)


def find_overlaps(outlines: Sequence[Tensor]) -> Tensor:
    """Return ``[B]`` bool: whether any two closed outlines ``[B, N, 2]`` lie in each other.

    On a CPU those whose boxes lie apart take no further time; on a GPU the host does not wait.
    """
    found = torch.zeros_like(outlines[0][:, 0, 0], dtype=torch.bool)
    for one, other in combinations(outlines, 2):
        if found.is_cuda or not _have_boxes_apart(one, other):
            found = found | _contains(one, other).any(-1) | _contains(other, one).any(-1)
    return found


def _have_boxes_apart(one: Tensor, other: Tensor) -> bool:
    is_apart = (one.amin(1) > other.amax(1)) | (other.amin(1) > one.amax(1))
    return bool(is_apart.any(-1).all())


def find_water(outlines: Sequence[Tensor], config: FlowConfig, rows: Tensor) -> Tensor:
    """Return ``[B, Y, X]`` bool: nodes of the flows ``rows`` ``[B]`` that are in no sharp skin."""
    water = rows[:, None, None].expand(-1, config.height, config.width)
    for outline in () if config.skin.has_water_inside else outlines:
        water = water & ~_find_covered(outline, config.width, config.height)
    return water


def _find_covered(outline: Tensor, width: int, height: int) -> Tensor:
    """Return ``[B, Y, X]`` bool: the nodes inside a closed outline ``[B, N, 2]`` of short segments.

    Along each row of nodes those inside lie behind an odd number of segments that cross the row.
    """
    (x, y), (x1, y1) = outline.unbind(-1), outline.roll(-1, 1).unbind(-1)
    row = torch.maximum(y.floor(), y1.floor())
    crosses = y.floor() != y1.floor()
    at = x + (x1 - x) * (row - y) / torch.where(crosses, y1 - y, 1.0)
    is_near = crosses & (row >= 0) & (row < height) & (at < width)
    first = at.nan_to_num(0.0).ceil().clamp(0, width - 1)
    node = torch.where(is_near, row * width + first, 0.0).long()
    count = torch.zeros(len(outline), height * width, dtype=torch.int64, device=outline.device)
    count.scatter_add_(1, node, is_near.long())
    return count.view(-1, height, width).cumsum(-1) % 2 == 1


def _contains(outline: Tensor, points: Tensor) -> Tensor:
    """Return ``[B, P]`` bool: whether points lie inside a closed outline, by its crossings."""
    x, y = points[:, :, None].unbind(-1)
    x0, y0 = outline[:, None].unbind(-1)
    x1, y1 = outline.roll(-1, 1)[:, None].unbind(-1)
    spans = (y0 > y) != (y1 > y)
    is_right = x < x0 + (x1 - x0) * (y - y0) / torch.where(spans, y1 - y0, 1.0)
    return (spans & is_right).sum(-1) % 2 == 1


def _require(flows: Tensor, is_right: Tensor, problem: str) -> None:
    """Raise ValueError for the first of some flows ``[B]`` that is not right, ``[B]`` bool."""
    if not is_right.all():
        raise ValueError(f"flow {int(flows[is_right.int().argmin()])}: {problem}")
