"""Starts of fish: from nose positions to bodies, and checks that they fit into the domain."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.sensors import compute_clearance
from fishrl.physics.bodies.outline import BodyConfig
from fishrl.physics.bodies.state import make_body
from fishrl.physics.flow import FlowConfig
from fishrl.physics.geometry import locate_markers


def place_fish(starts: TensorDictBase, fish: BodyConfig) -> tuple[Tensor, Tensor]:
    """Return centre of mass ``[B, 2]`` and heading ``[B]`` of straight fish at their starts.

    Starts of M fish give ``[B, M, 2]`` and ``[B, M]``.
    """
    heading: Tensor = starts["heading"]
    nose_to_centre = fish.centre
    direction = torch.stack((torch.cos(heading), torch.sin(heading)), -1)
    return starts["head"] - nose_to_centre * direction, heading


def place_outline(starts: TensorDictBase, fish: BodyConfig) -> Tensor:
    """Return the outline ``[B, N, 2]`` of straight fish at their starts; see ``place_fish``.

    Starts of M fish give ``[B, M, N, 2]``.
    """
    position, heading = place_fish(starts, fish)
    every = heading.reshape(-1)
    body = make_body(position.reshape(-1, 2), every, torch.zeros_like(every))
    shape = fish.make_params(heading.device)
    markers = locate_markers(shape, body)
    return markers.reshape(*heading.shape, *markers.shape[1:])


def check_pattern(starts: TensorDictBase, pattern: TensorDictBase) -> None:
    """Raise ValueError unless starts ``[E]`` have keys, shapes, dtypes of ``pattern`` ``[1]``."""
    if starts.batch_dims != 1 or starts.shape[0] < 1:
        raise ValueError(
            f"starts has batch shape {tuple(starts.shape)}: give a TensorDict of shape [E] with at "
            "least one start, as sample_starts does"
        )
    if unknown := sorted(set(map(str, starts.keys())) - set(map(str, pattern.keys()))):
        raise ValueError(f"starts has {unknown}, which sample_starts does not give: leave it out")
    for name, wanted in pattern.items():
        given = starts.get(name, None)
        shape = (starts.shape[0], *wanted.shape[1:])
        if given is None or tuple(given.shape) != shape or given.dtype != wanted.dtype:
            got = "nothing" if given is None else f"{tuple(given.shape)}, {given.dtype}"
            raise ValueError(
                f"starts[{name!r}] is {got}, expected {shape}, {wanted.dtype}: create starts like "
                "sample_starts"
            )


def check_fit(starts: TensorDictBase, fish: BodyConfig, flow: FlowConfig, *, margin: float) -> None:
    """Raise ValueError unless straight fish at starts keep ``margin`` nodes from the edges."""
    outlines = place_outline(starts, fish)
    every = outlines.flatten(0, -3)
    clearance = compute_clearance(every, flow)
    is_wrong = ~(clearance >= margin)
    if is_wrong.any():
        i = int(is_wrong.int().argmax())
        x, y = starts["head"].reshape(-1, 2)[i].tolist()
        where = "is too near the edge" if clearance[i] >= 0.0 else "lies outside the water"
        (left, bottom), (right, top) = flow.edges
        raise ValueError(
            f"start {i * len(outlines) // len(every)}, head at ({x:g}, {y:g}): the fish, or a part "
            f"of it, {where}; it must keep {margin:g} nodes from the edges of [{left:g}, "
            f"{right:g}] x [{bottom:g}, {top:g}], move it in"
        )
