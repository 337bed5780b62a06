"""Start, forces over time and pictures of wakes for cases with one body in a flow."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from matplotlib.axes import Axes
from torch import Tensor

from experiments.validation.case import Result
from fishrl.physics import Cylinder, DCylinder, Fixed, FlowConfig, InPlaceSolver, diagnostics
from fishrl.physics.boundaries import Boundaries, Boundary, NonEquilibrium, OpenEdge
from fishrl.physics.skins import DirectSolve, ImmersedBoundary, Skin

STREAM, PINNED = NonEquilibrium(velocity=(1.0, 0.0)), NonEquilibrium(density=1.0)
EXACT = DirectSolve(regularisation=0.0)
EXACT_SKIN = ImmersedBoundary(force_solve=EXACT)
OPEN, OPEN_SIDE = OpenEdge(), OpenEdge(is_plane=False)  # let sound out: plane waves, any waves
SLIDING = NonEquilibrium(velocity=(None, 0.0))  # sides along which the water moves


def start_flow(
    config: FlowConfig,
    place: Sequence[float],
    heading: float = 0.0,
    *,
    stream: tuple[float, float] = (0.0, 0.0),
    frequency: float = 0.0,
) -> InPlaceSolver:
    """Return a solver of one flow with its body at ``place`` (x, y), nodes.

    The fluid moves with ``stream``, in units of the stream speed; ``frequency`` of the body's
    motion is per step.
    """
    solver = InPlaceSolver(config=config, num_envs=1, frequency=frequency, num_workers=0)
    rows, position = torch.ones(1, dtype=torch.bool), torch.tensor([place])
    solver.reset_(rows, position, torch.tensor([heading]), velocity=stream)
    return solver


def start_stream(
    body: Cylinder | DCylinder,
    place: Sequence[float],
    heading: float = 0.0,
    *,
    size: tuple[int, int],
    tau: float,
    speed: float,
    inflow: Boundary = STREAM,
    outflow: Boundary = OPEN,
    sides: Boundary = OPEN_SIDE,
    skin: Skin = EXACT_SKIN,
) -> InPlaceSolver:
    """Return a body in a stream along x, by default with a direct force solve.

    ``place`` and ``size`` are in nodes, ``speed`` in nodes per step.
    """
    config = FlowConfig(
        width=size[0],
        height=size[1],
        tau=tau,
        stream_speed=speed,
        bodies=(body,),
        boundaries=Boundaries(left=inflow, right=outflow, bottom=sides, top=sides),
        skin=skin,
    )
    return start_flow(config, place, heading, stream=(1.0, 0.0))


def record(
    solver: InPlaceSolver, num: int, interval: int, read: Callable[[], Sequence[Tensor]]
) -> list[Tensor]:
    """Advance ``num`` times by ``interval`` steps; return what is read before and after each.

    Each tensor of ``read`` is returned with a new first axis of ``num + 1``.

    Raises:
        RuntimeError: for a flow that diverges.
    """
    found = [[value.clone() for value in read()]]
    for _ in range(num):
        solver.advance_(interval)
        found.append([value.clone() for value in read()])
    if bool(solver.is_diverged().any()):
        raise RuntimeError("the flow diverged: lower the speed or refine the grid")
    return [torch.stack(values) for values in zip(*found, strict=True)]


def kick(speed: float, diameter: float, travels: float = 3.0) -> Fixed:
    """Return a fixed body that is shaken at first, so that its wake sheds early."""
    return Fixed(kick_speed=0.3 * speed, kick_steps=round(travels * diameter / speed))


def make_even(number: float) -> int:
    """Return the nearest even number, at least 2."""
    return 2 * max(1, round(number / 2.0))


def measure_wake(
    solver: InPlaceSolver,
    travels: Sequence[float],
    window: Sequence[float],
    *,
    mean: float = 1.0,
    is_shedding: bool = True,
    per_travel: float = 30.0,
) -> Result:
    """Advance, and measure the force on the body over the later of two spans ``travels``.

    Lengths and times are in D and D / U, coefficients by the density of the second column; force is
    averaged ``per_travel`` times per D / U. U is the stream speed times ``mean``. The picture shows
    a ``window`` (left, right, low, high from the lower left corner). Without shedding the last
    quarter of the span is measured.

    Returns:
        ``drag`` and ``lift`` coefficients, their means over whole periods with shedding; then also
        ``strouhal`` by zero crossings of the lift, ``spectral`` by its spectrum, extremes, crest
        to trough ``_swing`` and ``lift_amplitude``; the last of the series, with their
        ``interval`` / (D / U), and ``vorticity`` / (U / D).
    """
    (body,) = solver.config.bodies
    assert isinstance(body, Cylinder | DCylinder)
    diameter, speed = body.diameter, mean * solver.config.stream_speed
    travel = diameter / speed
    interval = make_even(travel / per_travel)
    _record_force(solver, travels[0] * diameter / speed, interval)
    force = _record_force(solver, travels[1] * diameter / speed, interval)
    rho, u = solver.macroscopic()
    density = float(rho[0, :, 1].double().mean())
    scale: Any = {"length": diameter, "speed": speed, "rho": density}
    drag, lift = diagnostics.compute_coefficient(force, **scale).unbind(-1)
    left, right, low, high = (round(side * diameter) for side in window)
    stride = max(1, (right - left) // 240)  # at most 480 columns
    field = travel * diagnostics.compute_vorticity(u)[0, low:high:stride, left:right:stride]
    unit = interval / travel
    result: Result = {
        "inflow_density": density,
        "drag_series": [round(v, 5) for v in drag[-300:].tolist()],
        "lift_series": [round(v, 5) for v in lift[-300:].tolist()],
        "interval": unit,
        "vorticity": [[round(value, 2) for value in row] for row in field.double().tolist()],
    }
    if not is_shedding:
        late = -len(drag) // 4
        return result | {"drag": float(drag[late:].mean()), "lift": float(lift[late:].mean())}
    beat = diagnostics.measure_cycles(lift, unit)
    swing = diagnostics.measure_cycles(drag, unit, clock=lift)
    return result | {
        "strouhal": beat.frequency,
        "spectral": diagnostics.compute_spectral_frequency(lift, unit),
        "drag": swing.mean,
        "lift": beat.mean,
        "drag_max": swing.high,
        "drag_swing": swing.high - swing.low,
        "lift_max": beat.high,
        "lift_swing": beat.high - beat.low,
        "lift_amplitude": beat.amplitude,
    }


def _record_force(solver: InPlaceSolver, num_steps: float, interval: int) -> Tensor:
    """Advance and return the mean force on the first body over each interval, ``[n, 2]``."""
    num = round(round(num_steps) / interval)
    (impulse,) = record(solver, num, interval, lambda: [solver.body.impulse[0]])
    return impulse.diff(dim=0) / interval


def draw_vorticity(
    axes: Axes,
    run: Result,
    extent: Sequence[float],
    limit: float,
    *,
    length: str = "D",
    unit: str = "U / D",
) -> None:
    """Draw vorticity around a body at the origin, with units of length and vorticity."""
    left, right, low, high = extent
    image = axes.imshow(
        run["vorticity"], extent=(left, right, low, high), origin="lower", cmap="RdBu_r",
        vmin=-limit, vmax=limit, interpolation="bilinear",
    )  # fmt: skip
    axes.set(xlabel=f"x / {length}", ylabel=f"y / {length}", aspect="equal")
    axes.figure.colorbar(image, ax=axes, label=f"vorticity  [{unit}]", shrink=0.8)


def draw_series(axes: Axes, run: Result, key: str, name: str, shift: float = 0.0) -> None:
    """Draw a force coefficient over time."""
    values = [value + shift for value in run[f"{key}_series"]]
    axes.plot([i * run["interval"] for i in range(len(values))], values, label=name)
