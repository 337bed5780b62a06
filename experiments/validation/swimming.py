"""A fish that swims straight from rest, measured beat by beat; jobs of several cases."""

from math import pi
from typing import Any

from matplotlib.axes import Axes

from experiments.validation.case import Job, Result
from experiments.validation.wake import start_flow
from fishrl.physics import Commanded, Fish, Free, Scales, Section
from fishrl.physics.bodies.gait import GAITS
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.units import DEFAULT_WALL_SPEED

START_BL = 8.5  # of a tank of 10 L


def swim(
    *,
    body_length: int,
    num_beats: int,
    reynolds: float = 7142.0,
    max_wall_speed: float = 0.07,
    height_bl: float = 5.0,
    gait: str = "carling",
    section: str = "naca",
    thickness: float = 0.12,
    keeps_length: bool = False,
    is_free: bool = True,
    inset: float = 0.0,
) -> Result:
    """Swim along a tank of 10 L from rest.

    Args:
        body_length: L in nodes.
        num_beats: tail beats.
        reynolds: L^2 / (T nu).
        max_wall_speed: budget of the tail's speed, nodes per step.
        height_bl: height of the tank in L.
        gait: key of ``GAITS``.
        section: of the body.
        thickness: of the body in L.
        keeps_length: whether the midline keeps its length.
        is_free: whether the flow turns the fish; else its heading is held.
        inset: how far the markers lie inside the outline, nodes.

    Returns:
        ``speed`` along -x (L / T) and mean ``power`` of the muscles (rho L^4 / T^3) of each beat;
        the largest ``slip`` seen at the end of a beat and the ``tail_speed`` (L / T).
    """
    scales = Scales.from_budget(
        body_length=body_length,
        reynolds=reynolds,
        max_wall_speed=max_wall_speed,
        gait=GAITS[gait],
    )
    fish = Fish(
        body_length=body_length,
        section=Section(section),
        thickness=thickness,
        gait=GAITS[gait],
        keeps_length=keeps_length,
        motion=Free() if is_free else Commanded(),
        inset=inset,
    )
    config = make_swimmer_config(scales, height_bl=height_bl, bodies=(fish,))
    place = (START_BL * body_length, 0.5 * height_bl * body_length)
    solver = start_flow(config, place, pi, frequency=1.0 / scales.period)
    body = solver.body
    unit = body_length**4 * scales.reference_speed**2 / body_length**2
    speeds, powers, slips = [], [], []
    for _ in range(num_beats):
        x, work = body.position[0, 0].clone(), body.work[0].clone()
        solver.advance_(scales.period)
        speeds.append(float(x - body.position[0, 0]) / body_length)
        powers.append(float(body.work[0] - work) / unit)
        slips.append(float(body.slip_error[0]) / scales.reference_speed)
    if solver.is_diverged().any():
        raise RuntimeError(f"the flow diverged at L = {body_length}: lower max_wall_speed")
    tail_speed = scales.gait.tail_speed
    return {"speed": speeds, "power": powers, "slip": max(slips), "tail_speed": tail_speed}


def make_swim(
    body_length: int, num_beats: int, *, is_quick: bool = False, **changes: float | str | bool
) -> Job:
    """Return a job of ``swim``; ``changes`` are its other arguments."""
    speed = float(changes.get("max_wall_speed", DEFAULT_WALL_SPEED))
    tail_speed = GAITS[str(changes.get("gait", "carling"))].tail_speed
    num_steps = num_beats * tail_speed * body_length / speed
    arguments = {"body_length": body_length, "num_beats": num_beats, **changes}
    return Job(swim, arguments, cost=50.0 * body_length**2 * num_steps, is_quick=is_quick)


def draw_speed(axes: Axes, run: Result, *style: Any, **options: Any) -> None:
    """Draw the speed over each beat against time."""
    beats = [beat + 0.5 for beat in range(len(run["speed"]))]
    axes.plot(beats, run["speed"], *style, markersize=3, **options)
    axes.set_xlabel("time  t / T")
    axes.legend()
