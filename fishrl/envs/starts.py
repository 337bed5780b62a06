"""Starts of fish: from nose positions to bodies, and checks that they fit into the domain."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.sensors import compute_clearance
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.geometry import locate_markers
from fishrl.physics.bodies.state import make_body


def place_fish(starts: TensorDictBase, fish: Fish) -> tuple[Tensor, Tensor]:
    """Return centre of mass ``[B, 2]`` and heading ``[B]`` of straight fish at their starts."""
    heading: Tensor = starts["heading"]
    nose_to_centre = fish.centre
    direction = torch.stack((torch.cos(heading), torch.sin(heading)), -1)
    return starts["head"] - nose_to_centre * direction, heading


def place_outline(starts: TensorDictBase, fish: Fish) -> Tensor:
    """Return the outline ``[B, N, 2]`` of straight fish at their starts; see ``place_fish``."""
    position, heading = place_fish(starts, fish)
    body = make_body(position, heading, torch.zeros_like(heading))
    shape = fish.make_params(heading.device)
    return locate_markers(fish, shape, body)


def check_pattern(starts: TensorDictBase, pattern: TensorDictBase) -> None:
    """Raise ValueError unless starts ``[E]`` have keys, shapes, dtypes of ``pattern`` ``[1]``."""
    if starts.batch_dims != 1 or starts.shape[0] < 1:
        raise ValueError(
            f"starts has batch shape {tuple(starts.shape)}: give a TensorDict of shape [E] with at "
            "least one start, as sample_starts does"
        )
    for name, wanted in pattern.items():
        given = starts.get(name, None)
        shape = (starts.shape[0], *wanted.shape[1:])
        if given is None or tuple(given.shape) != shape or given.dtype != wanted.dtype:
            got = "nothing" if given is None else f"{tuple(given.shape)}, {given.dtype}"
            raise ValueError(
                f"starts[{name!r}] is {got}, expected {shape}, {wanted.dtype}: create starts like "
                "sample_starts"
            )


def check_fit(
    starts: TensorDictBase, fish: Fish, *, width: int, height: int, margin: float
) -> None:
    """Raise ValueError unless straight fish at starts keep ``margin`` nodes from the edges."""
    clearance = compute_clearance(place_outline(starts, fish), width=width, height=height)
    is_wrong = ~(clearance >= margin)
    if is_wrong.any():
        i = int(is_wrong.int().argmax())
        x, y = starts["head"][i].tolist()
        where = "is too near the edge" if clearance[i] >= 0.0 else "lies outside the domain"
        raise ValueError(
            f"start {i}, head at ({x:g}, {y:g}): the fish, or a part of it, {where}; it must keep "
            f"{margin:g} nodes from the edges of [0, {width - 1}] x [0, {height - 1}], move it in"
        )
