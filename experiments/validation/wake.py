"""What cases with bodies in a stream share: forces over time, densities, pictures of wakes."""

from collections.abc import Sequence

import torch
from matplotlib.axes import Axes
from torch import Tensor

from fishrl.physics import InPlaceSolver, compute_vorticity


def make_even(number: float) -> int:
    """Return the nearest even number, at least 2."""
    return 2 * max(1, round(number / 2.0))


def record_force(solver: InPlaceSolver, num_steps: int, interval: int) -> Tensor:
    """Advance and return the mean force on the first body over each interval, ``[n, 2]``.

    Args:
        solver: of one flow.
        num_steps: to advance, roughly.
        interval: even number of steps.
    """
    impulses = [solver.body.impulse[0].clone()]
    for _ in range(round(num_steps / interval)):
        solver.advance_(interval)
        impulses.append(solver.body.impulse[0].clone())
    return torch.stack(impulses).diff(dim=0) / interval


def take_vorticity(
    solver: InPlaceSolver, window: Sequence[int], *, scale: float
) -> list[list[float]]:
    """Return vorticity times ``scale`` in a window, on fewer than 480 columns.

    Args:
        solver: of one flow.
        window: first column, end column, first row, end row.
        scale: such as D / U.
    """
    _, u = solver.macroscopic()
    left, right, low, high = window
    stride = max(1, (right - left) // 240)
    field = compute_vorticity(u)[0, low:high:stride, left:right:stride] * scale
    return [[round(value, 2) for value in row] for row in field.double().tolist()]


def draw_vorticity(
    axes: Axes,
    field: Sequence[Sequence[float]],
    extent: tuple[float, float, float, float],
    *,
    limit: float,
) -> None:
    """Draw vorticity in units of U / D around a body at the origin; lengths in D."""
    image = axes.imshow(
        field, extent=extent, origin="lower", cmap="RdBu_r", vmin=-limit, vmax=limit,
        interpolation="bilinear",
    )  # fmt: skip
    axes.set(xlabel="x / D", ylabel="y / D", aspect="equal")
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(image, ax=axes, label="vorticity  [U / D]", shrink=0.8)
