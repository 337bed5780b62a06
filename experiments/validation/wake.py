"""What cases with one body in a flow share: its start, forces over time, pictures of wakes."""

from collections.abc import Sequence

import torch
from matplotlib.axes import Axes
from torch import Tensor

from experiments.validation.case import Result
from fishrl.physics import FlowConfig, InPlaceSolver, compute_coefficient, compute_vorticity
from fishrl.physics.diagnostics import compute_spectral_frequency, measure_cycles


def start_flow(
    config: FlowConfig,
    place: Sequence[float],
    heading: float = 0.0,
    *,
    stream: tuple[float, float] = (0.0, 0.0),
    frequency: float = 0.0,
) -> InPlaceSolver:
    """Return a solver of one flow with its body in place.

    Args:
        config: of the flow.
        place: centre of the body (x, y), nodes.
        heading: of the body, rad.
        stream: initial velocity of the fluid everywhere, in units of the stream speed.
        frequency: of the body's motion, per step.
    """
    solver = InPlaceSolver(config=config, num_envs=1, frequency=frequency, num_workers=0)
    solver.reset_(
        torch.ones(1, dtype=torch.bool),
        torch.tensor([place]),
        torch.tensor([heading]),
        velocity=stream,
    )
    return solver


def make_even(number: float) -> int:
    """Return the nearest even number, at least 2."""
    return 2 * max(1, round(number / 2.0))


def measure_wake(
    solver: InPlaceSolver,
    *,
    diameter: float,
    speed: float,
    num_steps: tuple[float, float],
    interval: int,
    window: Sequence[float],
    is_shedding: bool,
) -> Result:
    """Advance, and measure the force on the first body over the later of two spans.

    Args:
        solver: of one flow.
        diameter: D, nodes.
        speed: U of the coefficients, nodes per step; their density is that of the second column.
        num_steps: before and while measuring, roughly.
        interval: even number of steps, over which force is averaged.
        window: of the picture: first column, end column, first row, end row.
        is_shedding: whether to measure whole periods; else the last quarter of the span.

    Returns:
        ``drag`` and ``lift`` coefficients, or of periods ``strouhal`` by zero crossings of the
        lift, ``spectral`` by its spectrum, mean ``drag`` and the extremes and amplitudes of both;
        the last of the series, with their ``interval`` / (D / U), and ``vorticity`` / (U / D).
    """
    _record_force(solver, num_steps[0], interval)
    force = _record_force(solver, num_steps[1], interval)
    density = float(solver.macroscopic()[0][0, :, 1].double().mean())
    drag, lift = compute_coefficient(force, length=diameter, speed=speed, rho=density).unbind(-1)
    unit = interval * speed / diameter
    result: Result = {
        "inflow_density": density,
        "drag_series": [round(v, 5) for v in drag[-300:].tolist()],
        "lift_series": [round(v, 5) for v in lift[-300:].tolist()],
        "interval": unit,
        "vorticity": _take_vorticity(solver, [round(w) for w in window], scale=diameter / speed),
    }
    if not is_shedding:
        late = -len(drag) // 4
        return result | {"drag": float(drag[late:].mean()), "lift": float(lift[late:].mean())}
    beat, swing = measure_cycles(lift, unit), measure_cycles(drag, unit, clock=lift)
    return result | {
        "strouhal": beat.frequency,
        "spectral": compute_spectral_frequency(lift, unit),
        "num_cycles": beat.num_cycles,
        "drag": swing.mean,
        "drag_max": swing.high,
        "drag_min": swing.low,
        "lift_max": beat.high,
        "lift_min": beat.low,
        "lift_amplitude": beat.amplitude,
    }


def _record_force(solver: InPlaceSolver, num_steps: float, interval: int) -> Tensor:
    """Advance and return the mean force on the first body over each interval, ``[n, 2]``."""
    impulses = [solver.body.impulse[0].clone()]
    for _ in range(round(round(num_steps) / interval)):
        solver.advance_(interval)
        impulses.append(solver.body.impulse[0].clone())
    return torch.stack(impulses).diff(dim=0) / interval


def _take_vorticity(
    solver: InPlaceSolver, window: Sequence[int], *, scale: float
) -> list[list[float]]:
    """Return vorticity times ``scale`` in a window, on fewer than 480 columns."""
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
