"""Heading modes.

The swimmer (L = 50, Re = 7000) swims straight for 4 beats, is commanded to turn left by 15° in each
of the next 4, and continues to swim. In the commanded mode the heading follows the command and the
torque is external; in the bending mode the midline bends and the flow turns the fish. The rate is
the mean rotation of the body axis in the last two of the commanded beats.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import degrees, hypot, pi, radians

import torch
from matplotlib.figure import Figure

from experiments.validation.case import Case, Check, Job, Result, Runs
from experiments.validation.wake import start_flow
from fishrl.physics import Bending, Commanded, Fish, Scales
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.skins import Skin
from fishrl.physics.units import DEFAULT_WALL_SPEED
from fishrl.settings import build

BODY_LENGTH = 50
REYNOLDS = 7000.0
TURN = 15.0  # degrees per beat
NUM_BEFORE, NUM_TURNS, NUM_AFTER = 4, 4, 2
START_BL = (8.0, 3.5)
GAINS = (None, 0.5, 1.0, 2.0)
HEADLINE = "turn of the body axis, degrees per beat, bending, gain 1"


def turn(
    *,
    gain: float | None,
    skin: str = "immersed-boundary",
    body_length: int = BODY_LENGTH,
    reynolds: float = REYNOLDS,
    max_wall_speed: float = DEFAULT_WALL_SPEED,
    num_before: int = NUM_BEFORE,
    num_turns: int = NUM_TURNS,
) -> Result:
    """Swim straight, turn left and swim on, by command (no gain) or by bending with a gain.

    Returns the path (L), and of each beat the turn of the body axis (degrees) and speed (L / T).
    """
    scales = Scales.from_budget(
        body_length=body_length, reynolds=reynolds, max_wall_speed=max_wall_speed
    )
    motion = Commanded() if gain is None else Bending(gain=gain)
    fish = Fish(body_length=body_length, motion=motion)
    config = make_swimmer_config(scales, bodies=(fish,), skin=build(Skin, skin))
    start = [c * body_length for c in START_BL]
    solver = start_flow(config, start, pi, frequency=1.0 / scales.period)
    path, axes = [START_BL], [pi]
    for beat in range(num_before + num_turns + NUM_AFTER):
        is_turning = num_before <= beat < num_before + num_turns
        solver.command_(torch.tensor([radians(TURN) if is_turning else 0.0]), scales.period)
        solver.advance_(scales.period)
        x, y = (solver.body.position[0] / body_length).tolist()
        path.append((x, y))
        axes.append(float(solver.body.heading[0] + solver.body.internal_angle[0]))
    if solver.is_diverged().any():
        raise RuntimeError("the flow diverged")
    return {
        "x": [x for x, _ in path],
        "y": [y for _, y in path],
        "turned": [degrees(b - a) for a, b in pairwise(axes)],
        "speed": [hypot(c - a, d - b) for (a, b), (c, d) in pairwise(path)],
    }


JOBS = [Job(turn, {"gain": gain}, cost=7e8) for gain in GAINS]


def _select(runs: Runs) -> dict[str, Result]:
    found = runs.by("gain")
    return {f"bending, gain {g:g}" if g else "heading commanded": r for g, r in found.items()}


def judge(runs: Runs) -> Iterator[Check]:
    """Record turn rate and radius."""
    last = slice(NUM_BEFORE + NUM_TURNS - 2, NUM_BEFORE + NUM_TURNS)
    for mode, run in _select(runs).items():
        rate, speed = (sum(run[key][last]) / 2.0 for key in ("turned", "speed"))
        name = f"turn of the body axis, degrees per beat, {mode}"
        note = f"Speed {speed:.2f} L / T, turning radius {speed / radians(rate):.1f} L."
        yield Check(name, rate, resolution=f"L = {BODY_LENGTH}", note=note)


def draw(figure: Figure, runs: Runs) -> None:
    """Draw the paths."""
    axes = figure.subplots()
    for mode, run in _select(runs).items():
        axes.plot(run["x"], run["y"], "o-", ms=3, label=mode)
    axes.set(xlabel="x / L", ylabel="y / L", aspect="equal", title="centre of mass, every beat")


CASE = Case("turning", __doc__, "none", JOBS, judge, draw, (6.5, 3.8), HEADLINE)
