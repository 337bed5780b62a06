"""What is read off a flow."""

import torch
from torch import Tensor


def compute_vorticity(u: Tensor) -> Tensor:
    """Return dv/dx - du/dy ``[B, Y, X]`` per step by central differences (one-sided at edges).

    Args:
        u: velocity ``[B, 2, Y, X]``.
    """
    (dv_dx,) = torch.gradient(u[:, 1], dim=-1)
    (du_dy,) = torch.gradient(u[:, 0], dim=-2)
    return dv_dx - du_dy


def compute_area(outline: Tensor) -> Tensor:
    """Return the area ``[B]`` enclosed by closed outlines ``[B, N, 2]``, nodes^2 (shoelace)."""
    x, y = outline.unbind(-1)
    return 0.5 * (x * y.roll(-1, -1) - y * x.roll(-1, -1)).sum(-1).abs()


def compute_pressure(rho: Tensor) -> Tensor:
    """Return p = (rho - 1) / 3, of the shape of ``rho``, lattice units; 0 at the rest density."""
    return (rho - 1.0) / 3.0


def find_crossings(signal: Tensor) -> Tensor:
    """Return when a signal ``[S]`` rises through its mean, in samples, by linear interpolation."""
    swing = signal - signal.mean()
    rises = ((swing[:-1] < 0.0) & (swing[1:] >= 0.0)).nonzero()[:, 0]
    return rises + swing[rises] / (swing[rises] - swing[rises + 1])


def find_period(signal: Tensor) -> Tensor:
    """Return the mean period of a signal ``[S]``, in samples, between its first and last rise.

    Raises:
        ValueError: if it rises through its mean less than twice.
    """
    times = find_crossings(signal)
    if len(times) < 2:
        raise ValueError(
            f"a signal of {len(signal)} samples rises through its mean {len(times)} times: a "
            "period needs two; record for longer"
        )
    return (times[-1] - times[0]) / (len(times) - 1)


def average_periods(signal: Tensor) -> Tensor:
    """Return the mean of a periodic signal ``[S, ...]`` over its whole periods, by the first rise.

    The first column decides where periods begin where there are several.
    """
    lead = signal if signal.dim() == 1 else signal.flatten(1)[:, 0]
    times = find_crossings(lead).round().long()
    if len(times) < 2:
        return signal.mean(0)
    return signal[times[0] : times[-1]].mean(0)
