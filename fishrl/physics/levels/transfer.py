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

import torch
from torch import Tensor
from torch.nn.functional import pad

from fishrl.physics.collision import Moments, measure_moments, rebuild
from fishrl.physics.levels.patch import RING

#: Layers of a patch that do not reach the parent: the ring, and as many that depend on it most.
FIRST_RESTRICTED = 4


def number_cells(height: int, width: int, row: int, first: int = 0) -> Tensor:
    """Return numbers ``[height, width]`` of nodes, ``first`` and more nodes along x and y.

    There are ``row`` numbers from one row to the next.
    """
    return torch.arange(first, first + height)[:, None] * row + torch.arange(first, first + width)


def list_parents(width: int, height: int, row: int) -> Tensor:
    """Return the numbers of the parent's nodes below a patch, and of one more on each side.

    They count from the patch's first node, with ``row`` from one row of the parent to the next.
    """
    return number_cells(height // 2 + 3, width // 2 + 3, row, -1)


def list_sources(width: int, height: int, row: int) -> Tensor:
    """Return those ``[2, 4, N]`` from which two opposite sides are filled, outermost line first.

    Bottom and top come first, along x; then left and right, along y.
    """
    cells = list_parents(width, height, row)
    return torch.cat([_list_lines(own, 4) for own in (cells, cells.mT)], -1)


def number_ring(width: int, height: int, row: int) -> Tensor:
    """Return the numbers ``[8 (N - 3)]`` of the patch's nodes that ``fill_ring`` has values of.

    There are ``row`` from one row to the next; values that belong to none have -1.
    """
    cells, sides = number_cells(height, width, row), []
    for own, crop in ((cells, 0), (cells.mT, RING)):  # corners belong to bottom and top
        lines = _list_lines(own, RING)[..., crop : own.shape[1] - crop]
        padded = pad(lines, (crop, crop + 5), value=-1)  # to two for each of the sources
        sides.append(padded.unflatten(-1, (-1, 2)).mT)
    return torch.cat(sides, -1)[..., :-3].flatten()


def _list_lines(cells: Tensor, num: int) -> Tensor:
    """Return the first and the last lines ``[2, num, n]`` of numbers, outermost first."""
    return torch.stack((cells[:num], cells[-num:].flip(0)))


def fill_ring(f: Sequence[Tensor], tau: Tensor) -> Tensor:
    """Return the populations ``[Q, B, 8 (N - 3)]`` that the parent puts into a patch's ring.

    They are those of both layers of both sides, on and between the parent's nodes. Some are between
    the end of one side and the beginning of another, of no node.

    Args:
        f: nine populations ``[B, 2, 4, N]`` of ``list_sources``.
        tau: ``[B]``, the patch's.
    """
    moments = torch.stack(measure_moments(f))  # in memory, each moment once
    layers = torch.stack((moments[..., 1, :], _halve(moments.mT)[..., 0]), -2)
    nodes = torch.stack((layers[..., 1:-2], _halve(layers)), -2).flatten(2)
    return torch.stack(rebuild(Moments(*nodes), _compute_ratio(tau, nodes[0]), 0.5))


def coarsen(f: Sequence[Tensor], tau: Tensor) -> list[Tensor]:
    """Return the parent's populations at a patch's nodes ``[B, ...]``; ``tau`` is the patch's."""
    return rebuild(measure_moments(f), 1.0 / _compute_ratio(tau, f[0]), 2.0)


def _compute_ratio(tau: Tensor, like: Tensor) -> Tensor:
    return (tau / (tau + 0.5)).to(like.dtype).view(-1, *[1] * (like.dim() - 1))


def _interpolate(values: Tensor) -> Tensor:
    """Return n + 3 values ``[..., n + 3]`` and those between them, 2 n + 1, without the ends."""
    pairs = torch.stack((values[..., 1:-2], _halve(values)), -1).flatten(-2)
    return torch.cat((pairs, values[..., -2:-1]), -1)


def _halve(values: Tensor) -> Tensor:
    """Return the n values halfway between the inner ones of ``[..., n + 3]``."""
    before, here, after, beyond = (values[..., k : values.shape[-1] - 3 + k] for k in range(4))
    return (9.0 * (here + after) - (before + beyond)) * (1 / 16)


def fill(patch: Tensor, parent: Tensor, origin: Tensor, tau: Tensor) -> Tensor:
    """Return a patch's populations with its ring filled by the parent.

    Args:
        patch: ``[B, Q, h, w]``.
        parent: ``[B, Q, Y, X]``.
        origin: ``[B, 2]`` int64, (x, y) of the patch's first node in the parent.
        tau: ``[B]``, the patch's.
    """
    (height, width), row = patch.shape[-2:], parent.shape[-1]
    sources = add(count(origin, row), list_sources(width, height, row))
    values = fill_ring(read(parent.flatten(2).unbind(1), sources), tau)
    ring = number_ring(width, height, width)
    is_node = ring >= 0
    return write(patch, ring[is_node].expand(len(patch), -1), values[..., is_node].transpose(0, 1))


def fill_all(size: tuple[int, int], parent: Tensor, origin: Tensor, tau: Tensor) -> Tensor:
    """Return populations ``[B, Q, h, w]`` of a patch of (width, height) from those of its parent.

    Arguments are as for ``fill``.
    """
    row = parent.shape[-1]
    f = read(parent.flatten(2).unbind(1), add(count(origin, row), list_parents(*size, row)))
    between = (_interpolate(_interpolate(m.mT).mT) for m in measure_moments(f))
    return torch.stack(rebuild(Moments(*between), _compute_ratio(tau, f[0]), 0.5), 1)


def list_restricted(planes: Sequence[Tensor]) -> list[Tensor]:
    """Return views of those nodes of a patch's planes ``[B, h, w]`` that its parent takes."""
    inner = slice(FIRST_RESTRICTED, -FIRST_RESTRICTED, 2)
    return [plane[:, inner, inner] for plane in planes]


def restrict(parent: Tensor, patch: Tensor, origin: Tensor, tau: Tensor) -> Tensor:
    """Return a parent's populations with those under the patch replaced; arguments of ``fill``."""
    f, row = torch.stack(coarsen(list_restricted(patch.unbind(1)), tau), 1), parent.shape[-1]
    height, width = f.shape[-2:]
    cells = number_cells(height, width, row, FIRST_RESTRICTED // 2)
    return write(parent, add(count(origin, row), cells), f)


def move(f: Sequence[Tensor], shift: Tensor) -> list[Tensor]:
    """Return nine populations ``[B, h, w]`` after the patch moves by parent nodes ``[B, 2]``.

    The ring that enters holds copies; it must be filled.
    """
    height, width = f[0].shape[1:]
    x, y = (
        add(2 * by, torch.arange(num, device=by.device)).clamp(0, num - 1)
        for by, num in zip(shift.unbind(-1), (width, height), strict=True)
    )
    return read([g.flatten(1) for g in f], y[:, :, None] * width + x[:, None])


def clamp_origin(origin: Tensor, low: tuple[int, int], high: tuple[int, int]) -> Tensor:
    """Return origins ``[B, 2]`` within ``low`` and ``high`` (x, y)."""
    parts = [o.clamp(*ends) for *ends, o in zip(low, high, origin.unbind(-1), strict=True)]
    return torch.stack(parts, -1)


def count(origin: Tensor, row: int | Tensor) -> Tensor:
    """Return the numbers ``[B]`` of nodes (x, y) ``[B, 2]`` of a grid, ``row`` in each row."""
    return origin[:, 1] * row + origin[:, 0]


def add(first: Tensor, cells: Tensor) -> Tensor:
    """Return numbers ``[...]`` that count from those of each flow, ``[B, ...]``."""
    return first.view(-1, *[1] * cells.dim()) + cells.to(first.device)


def read(f: Sequence[Tensor], cells: Tensor) -> list[Tensor]:
    """Return populations ``[B, N]`` at the nodes with given numbers ``[B, ...]``."""
    return [g.gather(1, cells.flatten(1)).view_as(cells) for g in f]


def write(f: Tensor, cells: Tensor, values: Tensor) -> Tensor:
    """Return ``f`` ``[B, Q, Y, X]`` with ``values`` ``[B, Q, ...]`` at nodes ``[B, ...]``."""
    index = cells.to(f.device).flatten(1)[:, None].expand(-1, f.shape[1], -1)
    return f.flatten(2).scatter(2, index, values.flatten(2)).view_as(f)
