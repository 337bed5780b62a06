"""What passes between a grid and a finer one in it: pure functions of tensors.

A finer grid, the *patch*, has half the spacing and half the time step of its *parent*, and the same
velocities. Its node (2 i, 2 j) lies on the parent's node (i, j) + ``origin``; it has odd numbers of
nodes. Equal viscosity means tau_f = 2 tau_c - 1/2 (f fine, c coarse), and equal stresses mean that
the part of a moment beyond equilibrium, n = m - m_eq, which is proportional to time step over
rate, differs (Filippova & Haenel 1998, Dupuis & Chopard 2003, here for all six moments)::

    n_f = r n_c,   r = tau_f / (tau_f + 1/2) for p_xx and p_xy,   1/2 for e, eps, q_x and q_y
    f = f_eq(rho, u) + M^-1 n

Density and momentum are the same. Both ways this acts on incoming populations:

* **fill**: the two outermost layers of the patch, its *ring*, take the parent's moments, between
  its nodes by the cubic through four of them, (-1, 9, 9, -1) / 16, along x and y. Two steps of the
  patch use these two layers up, so nothing is interpolated in time.
* **restrict**: parent's nodes that lie at least four layers inside the patch take its moments.

Dropping eps and q at the interface, as others do against noise, is worse than no patch.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from fishrl.physics.collision import Moments, measure_moments, rebuild
from fishrl.physics.levels.patch import RING

#: Layers of a patch that do not reach the parent: the ring, and as many that depend on it most.
_FIRST_RESTRICTED = 4


class Strip(NamedTuple):
    """Two layers along two opposite sides of a patch, and the rows of the parent they come from.

    The outermost layer comes first; nodes are int64.
    """

    parent_x: Tensor  #: ``[2, 4, n + 3]`` relative to the origin
    parent_y: Tensor
    x: Tensor  #: ``[2, 2, m]`` in the patch
    y: Tensor
    crop: int  #: nodes at both ends of the layers that the other two sides fill


def list_strips(width: int, height: int) -> list[Strip]:
    """Return bottom and top, and left and right, of a patch's ring."""
    strips = []
    for length, depth, crop in ((width, height, 0), (height, width, RING)):
        along, parents = torch.arange(crop, length - crop), torch.arange(-1, length // 2 + 2)
        layers, rows = torch.arange(2), torch.arange(-1, 3)
        across = torch.stack((layers, depth - 1 - layers))[..., None]
        coarse = torch.stack((rows, depth // 2 - rows))[..., None]
        own = torch.broadcast_tensors(along, across)
        parent = torch.broadcast_tensors(parents, coarse)
        (x, y), (px, py) = (own[::-1], parent[::-1]) if crop else (own, parent)
        px, py, x, y = (table.contiguous() for table in (px, py, x, y))
        strips.append(Strip(px, py, x, y, crop))
    return strips


def list_restricted(
    width: int, height: int, num_layers: int | None = None
) -> tuple[Tensor, Tensor]:
    """Return (x, y) ``[K]`` of a patch's nodes that the parent takes; None is all layers of them.

    The first two keep all that lies outside the patch, or will when it shifts, independent of what
    the parent has further inside.
    """
    y, x = torch.meshgrid(torch.arange(0, height, 2), torch.arange(0, width, 2), indexing="ij")
    depth = torch.minimum(torch.minimum(x, width - 1 - x), torch.minimum(y, height - 1 - y))
    last = max(width, height) if num_layers is None else _FIRST_RESTRICTED + 2 * num_layers - 1
    chosen = (depth >= _FIRST_RESTRICTED) & (depth <= last)
    return x[chosen], y[chosen]


def refine(f: Sequence[Tensor], tau: Tensor) -> list[Tensor]:
    """Return a patch's populations from those of its parent's nodes, one more beyond each end.

    Args:
        f: nine populations of the parent, ``[B, ny + 3, nx + 3]``.
        tau: relaxation time of the patch, ``[B]``.

    Returns:
        Nine ``[B, 2 ny + 1, 2 nx + 1]``.
    """
    between = (_interpolate(_interpolate(m.mT).mT) for m in measure_moments(f))
    return rebuild(Moments(*between), _compute_ratio(tau, f[0]), 0.5)


def coarsen(f: Sequence[Tensor], tau: Tensor) -> list[Tensor]:
    """Return the parent's populations at a patch's nodes ``[B, ...]``; ``tau`` is the patch's."""
    return rebuild(measure_moments(f), 1.0 / _compute_ratio(tau, f[0]), 2.0)


def _compute_ratio(tau: Tensor, like: Tensor) -> Tensor:
    return (tau / (tau + 0.5)).to(like.dtype).view(-1, *[1] * (like.dim() - 1))


def _interpolate(values: Tensor) -> Tensor:
    """Return n + 3 values ``[..., n + 3]`` and those between them, 2 n + 1, without the ends."""
    n = values.shape[-1] - 3
    before, here, after, beyond = (values[..., k : k + n] for k in range(4))
    between = (9.0 * (here + after) - (before + beyond)) * (1 / 16)
    pairs = torch.stack((here, between), -1).flatten(-2)
    return torch.cat((pairs, values[..., n + 1 : n + 2]), -1)


def fill(patch: Tensor, parent: Tensor, origin: Tensor, tau: Tensor) -> Tensor:
    """Return a patch's populations with its ring filled by the parent.

    Args:
        patch: ``[B, Q, h, w]``.
        parent: ``[B, Q, Y, X]``.
        origin: ``[B, 2]`` int64, (x, y) of the patch's first node in the parent.
        tau: ``[B]``, the patch's.
    """
    for strip in list_strips(patch.shape[-1], patch.shape[-2]):
        x, y = (_move(p, origin, axis) for axis, p in enumerate((strip.parent_x, strip.parent_y)))
        ring = crop_ring(torch.stack(refine(read(parent, x, y), tau), 1), strip.crop)
        patch = write(patch, strip.x.expand(len(patch), -1, -1, -1), strip.y, ring)
    return patch


def crop_ring(values: Tensor, crop: int) -> Tensor:
    """Return the layers ``[..., 2, m]`` of ``Strip`` of refined values."""
    return values[..., :RING, crop : values.shape[-1] - crop]


def fill_all(size: tuple[int, int], parent: Tensor, origin: Tensor, tau: Tensor) -> Tensor:
    """Return populations ``[B, Q, h, w]`` of a patch of (width, height) from those of its parent.

    Arguments are as for ``fill``.
    """
    width, height = size
    py, px = torch.meshgrid(
        torch.arange(-1, height // 2 + 2), torch.arange(-1, width // 2 + 2), indexing="ij"
    )
    f = read(parent, _move(px, origin, 0), _move(py, origin, 1))
    return torch.stack(refine(f, tau), 1)


def restrict(parent: Tensor, patch: Tensor, origin: Tensor, tau: Tensor) -> Tensor:
    """Return a parent's populations with those under the patch replaced; arguments of ``fill``."""
    x, y = list_restricted(patch.shape[-1], patch.shape[-2])
    every = torch.zeros_like(origin[:, :1])
    f = torch.stack(coarsen(read(patch, x + every, y + every), tau), 1)
    return write(parent, _move(x // 2, origin, 0), _move(y // 2, origin, 1), f)


def move(patch: Tensor, shift: Tensor) -> Tensor:
    """Return the populations ``[B, Q, h, w]`` after the patch moves by parent nodes ``[B, 2]``.

    The ring that enters holds copies; it must be filled.
    """
    height, width = patch.shape[-2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x = _move(x, 2 * shift, 0).clamp(0, width - 1)
    y = _move(y, 2 * shift, 1).clamp(0, height - 1)
    return torch.stack(read(patch, x, y), 1)


def choose_shift(
    point: Tensor,
    origin: Tensor,
    size: tuple[int, int],
    low: tuple[int, int],
    high: tuple[int, int],
) -> Tensor:
    """Return by how many parent nodes ``[B, 2]`` to move a patch: -1, 0 or 1 along x and y.

    It moves when the followed ``point`` ``[B, 2]``, in nodes of the patch, is more than two of them
    from its middle, while its ``origin`` stays within ``low`` and ``high``.
    """
    # numbers, as compiled code keeps no constant tensors
    ahead = [p - 0.5 * (n - 1) for p, n in zip(point.unbind(-1), size, strict=True)]
    wanted = torch.stack([(d > 2.0).long() - (d < -2.0).long() for d in ahead], -1)
    return clamp_origin(origin + wanted, low, high) - origin


def clamp_origin(origin: Tensor, low: tuple[int, int], high: tuple[int, int]) -> Tensor:
    """Return origins ``[B, 2]`` within ``low`` and ``high`` (x, y)."""
    parts = [o.clamp(*ends) for *ends, o in zip(low, high, origin.unbind(-1), strict=True)]
    return torch.stack(parts, -1)


def read(f: Tensor, x: Tensor, y: Tensor) -> list[Tensor]:
    """Return nine populations at nodes (x, y) ``[B, ...]`` of ``f`` ``[B, Q, Y, X]``."""
    index = (y * f.shape[-1] + x).flatten(1)[:, None].expand(-1, f.shape[1], -1)
    return [*f.flatten(2).gather(2, index).view(*f.shape[:2], *x.shape[1:]).unbind(1)]


def write(f: Tensor, x: Tensor, y: Tensor, values: Tensor) -> Tensor:
    """Return ``f`` with ``values`` ``[B, Q, ...]`` at nodes (x, y) ``[B, ...]``."""
    index = (y * f.shape[-1] + x).flatten(1)[:, None].expand(-1, f.shape[1], -1)
    return f.flatten(2).scatter(2, index, values.flatten(2)).view_as(f)


def _move(nodes: Tensor, by: Tensor, axis: int) -> Tensor:
    """Return node numbers ``[...]`` moved by those of each flow, ``[B, ...]``."""
    return nodes.to(by.device) + by[:, axis].view(-1, *[1] * nodes.dim())
