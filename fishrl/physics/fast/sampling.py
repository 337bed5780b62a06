"""Reading a flow between its nodes."""

import torch
from torch import Tensor

from fishrl.physics.collision import compute_macroscopic
from fishrl.physics.fast.layout import InPlaceLayout
from fishrl.physics.storage import Storage


def sample_points(
    points: Tensor, populations: Tensor, layout: InPlaceLayout, storage: Storage
) -> tuple[Tensor, Tensor]:
    """Read density and velocity between the nodes, bilinearly, before an even step.

    Args:
        points: ``[B, P, 2]`` (x, y) in nodes; those outside the grid are moved to its edge, and
            where one is NaN, so is the result.
        populations: ``[groups, num_slots]`` of the B flows, as stored.
        layout: layout of one group.
        storage: number format.

    Returns:
        Density ``[B, P]`` and velocity ``[B, P, 2]``, float32.
    """
    last = torch.tensor([layout.width - 1.0, layout.height - 1.0], device=points.device).to(points)
    place = torch.minimum(points.nan_to_num().clamp_min(0.0), last)
    first = torch.minimum(place.floor(), last - 1.0)
    right, up = (place - first).float().unbind(-1)
    x, y = first.long().unbind(-1)
    node = y * layout.row_length + x
    above = node + layout.row_length
    corners = torch.stack((node, node + 1, above, above + 1), 1)
    weights = torch.stack(
        ((1 - up) * (1 - right), (1 - up) * right, up * (1 - right), up * right), 1
    )
    flow = torch.arange(len(points), device=points.device)[:, None, None]
    group, own = flow // layout.num_envs, flow % layout.num_envs
    cells = corners + own * layout.flow_length + layout.first_cell
    f = [storage.decode(populations[group, cells + offset]) for offset in layout.offsets(0, False)]
    fluid = compute_macroscopic(f)
    values = torch.stack((fluid.rho, fluid.ux, fluid.uy), -1)
    mean = (weights[..., None] * values).sum(1)
    mean = mean.masked_fill(points.isnan().any(-1, keepdim=True), torch.nan)
    return mean[..., 0], mean[..., 1:]
