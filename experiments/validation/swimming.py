"""A fish that swims straight from rest, measured beat by beat; jobs of several cases."""

from math import pi

import torch

from experiments.validation.case import Result
from fishrl.physics import Commanded, Fish, Free, InPlaceSolver, Scales
from fishrl.physics.bodies.gait import GAITS
from fishrl.physics.bodies.sections import Section
from fishrl.physics.cases import make_swimmer_config

TANK_LENGTH_BL = 10.0
START_BL = 8.5


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
        Of each beat the speed along -x and along y (L / T) and the mean power of the muscles
        (rho L^4 / T^3), signed and without what the flow gives back; of the last step the heading
        (degrees off the start), and the largest slip seen at the end of a beat (L / T).
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
    solver = InPlaceSolver(config=config, frequency=1.0 / scales.period, num_workers=0)
    start = torch.tensor([[START_BL, 0.5 * height_bl]], dtype=torch.float64) * body_length
    solver.reset_(torch.ones(1, dtype=torch.bool), start, torch.tensor([pi]))
    unit = body_length**4 * scales.reference_speed**2 / body_length**2
    result: dict[str, list[float]] = {"speed": [], "drift": [], "power": [], "positive_power": []}
    slips, before = [], solver.state_dict()
    for _ in range(num_beats):
        solver.advance_(scales.period)
        after = solver.state_dict()

        def change(name: str) -> torch.Tensor:
            return after[f"bodies[0].{name}"][0] - before[f"bodies[0].{name}"][0]  # noqa: B023

        moved = change("position") / body_length
        result["speed"].append(-float(moved[0]))
        result["drift"].append(float(moved[1]))
        result["power"].append(float(change("work")) / unit)
        result["positive_power"].append(float(change("positive_work")) / unit)
        slips.append(float(solver.body.slip_error[0]) / scales.reference_speed)
        before = after
    if solver.is_diverged().any():
        raise RuntimeError(f"the flow diverged at L = {body_length}: lower max_wall_speed")
    heading = float((solver.body.heading + solver.body.internal_angle)[0]) - pi
    return {
        **result,
        "heading": heading * 180.0 / pi,
        "slip": max(slips),
        "tau": scales.tau,
        "period": scales.period,
        "tail_speed": scales.gait.tail_speed,
    }


def estimate_cost(body_length: int, num_beats: int, max_wall_speed: float = 0.07) -> float:
    """Return the node-steps of ``swim``."""
    return 50.0 * body_length**2 * num_beats * 0.785 * body_length / max_wall_speed
