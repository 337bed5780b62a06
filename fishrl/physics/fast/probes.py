"""Reading the flow at a few points, without touching the rest of it."""

import torch
from torch import Tensor

from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.storage import Storage


def sample_flow(
    data: Tensor, layout: InPlaceLayout, storage: Storage, points: Tensor
) -> tuple[Tensor, Tensor]:
    """Read density and velocity between the nodes, bilinearly, before an even step.

    Args:
        data: ``[groups, slots]`` populations of all flows B.
        layout: of one group.
        storage: how they are kept.
        points: ``[B, P, 2]`` (x, y) in nodes; those outside the grid are moved to its edge.

    Returns:
        Density ``[B, P]`` and velocity ``[B, P, 2]``, float32.
    """
    device = data.device
    last = torch.tensor([layout.width - 1.0, layout.height - 1.0], device=device)
    place = torch.minimum(points.nan_to_num().clamp_min(0.0), last.to(points))
    first = torch.minimum(place.floor(), last.to(points) - 1.0)
    right, up = (place - first).float().unbind(-1)
    x, y = first.long().unbind(-1)
    node = y * layout.row_length + x
    corners = torch.stack(
        (node, node + 1, node + layout.row_length, node + layout.row_length + 1), 1
    )
    weights = torch.stack(
        ((1 - up) * (1 - right), (1 - up) * right, up * (1 - right), up * right), 1
    )
    flow = torch.arange(len(points), device=device)[:, None, None]
    group, own = flow // layout.num_envs, flow % layout.num_envs
    cells = corners + own * layout.flow_length + layout.first_cell
    f = [storage.decode(data[group, cells + offset]) for offset in layout.offsets(0, False)]
    fluid = compute_macroscopic(f)
    values = torch.stack((fluid.rho, fluid.ux, fluid.uy), -1)
    mean = (weights[..., None] * values).sum(1)
    return mean[..., 0], mean[..., 1:]
