"""What is drawn of every task: the flow, the bodies, the edges, reward and action."""

from collections.abc import Sequence
from math import pi

import torch
from torch import Tensor

from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.protocol import Solver
from fishrl.envs.scene import Area, Choice, Curve, Field, Marks, Panel, Scene, Series, Trail
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.diagnostics import compute_vorticity
from fishrl.physics.flow import FlowConfig
from fishrl.physics.units import Scales

FISH, MIDLINE, OBSTACLE = (32, 37, 43), (240, 240, 240), (110, 110, 110)
#: Below this speed, L / T, a fish in still water has no direction of swimming.
_MIN_SPEED = 0.05
_PRESSURES = ("pressure", "p")
#: Unit of each feature of a neuromast, and the value at which its colour saturates.
_FEATURES = {
    **dict.fromkeys(_PRESSURES, ("ρ (L/T)²", 1.0)),
    "t": ("T", 10.0), "x": ("L", 10.0), "y": ("L", 5.0), "shear": ("1/T", 50.0),
}  # fmt: skip
_VELOCITY = ("L/T", 2.0)
_SIDES = ("right", "left")


def make_flow_scene(
    config: FlowConfig, scales: Scales, *, wall_margin: float, action_names: tuple[str, ...]
) -> Scene:
    """Return the scene of a fish, the first body, ``wall_margin`` nodes off the edges."""
    plots = (
        ("tail-beat frequency [1/T]", Series(key="frequency", label="frequency"), True),
        ("angle of attack [°]", Series(key="angle_of_attack", label="angle"), False),
        ("power [ρ L⁴/T³]", Series(key="work", label="power", is_rate=True), True),
    )
    reward = Series(key="reward", label="reward")
    return Scene(
        body_length=float(scales.body_length),
        width=config.width,
        height=config.height,
        field=Field(
            key="vorticity",
            name="vorticity",
            unit="1/T",
            limit=15.0,
            note="positive turns counter-clockwise",
        ),
        curves=(
            Curve(key="fish", colour=FISH),
            Curve(key="midline", colour=MIDLINE, is_closed=False, order=5.0),
            *(Curve(key=key, colour=OBSTACLE) for key in _name_obstacles(config)),
        ),
        trails=(Trail(key="head"),),
        areas=(
            Area(
                key="edges",
                low=(wall_margin, wall_margin),
                high=(config.width - 1.0 - wall_margin, config.height - 1.0 - wall_margin),
            ),
        ),
        panels=(
            Panel(name="reward", series=(reward,), is_step=True, is_output=True),
            Choice(names=action_names),
            *(Panel(name=name, series=(line,), is_step=step) for name, line, step in plots),
        ),
        note="Angle of attack: of the heading, from upstream; in still water from the direction of "
        "swimming. Power: of the muscles, mean since the previous frame.",
    )


def read_flow_scene(solver: Solver, scales: Scales) -> dict[str, Tensor]:
    """Return ``[B, ...]`` tensors by the keys of ``make_flow_scene``."""
    body, markers = solver.body, solver.markers()
    length, period = scales.body_length, scales.period
    half = markers.shape[1] // 2
    other_side = -torch.arange(half + 1, device=markers.device) % markers.shape[1]
    obstacles = enumerate(_name_obstacles(solver.config)[: len(solver.bodies) - 1], 1)
    return {
        "vorticity": (compute_vorticity(solver.macroscopic()[1]) * period).half(),
        "fish": markers,
        "midline": 0.5 * (markers[:, : half + 1] + markers[:, other_side]),
        "head": markers[:, 0],
        "heading": body.heading,
        "frequency": body.frequency * period,
        "work": body.work / (length * length / period) ** 2,
        "angle_of_attack": _measure_angle(
            body, min_speed=_MIN_SPEED * length / period, is_stream=solver.config.fastest_edge > 0.0
        ),
        **{key: solver.markers(index) for index, key in obstacles},
    }


def describe_lateral_line(line: LateralLine, *, body_length: float) -> tuple[Marks, Panel]:
    """Return neuromasts coloured by what they sense, and a plot of it; keys: neuromasts, signal.

    Of several features it is the pressure, or the first one.
    """
    feature = line.features[find_shown_feature(line)]
    unit, limit = _FEATURES.get(feature, _VELOCITY)
    pairs = [f"{side} {k}" for k in range(1, line.num_neuromasts // 2 + 1) for side in _SIDES]
    names = ["nose"] * (line.num_neuromasts % 2) + pairs  # in the order of LateralLine.place
    marks = Marks(
        key="neuromasts",
        radius=2.0 * body_length / 50.0,
        value="signal",
        name=f"{feature} at neuromasts",
        unit=unit,
        limit=limit,
    )
    series = tuple(Series(key="signal", column=i, label=name) for i, name in enumerate(names))
    return marks, Panel(name=f"{feature} at neuromasts [{unit}]", series=series)


def describe_flow_label(names: Sequence[str]) -> Panel:
    """Return a plot of the probabilities that a transform gives to flows of these names."""
    series = tuple(
        Series(key="flow_probabilities", column=index, label=name)
        for index, name in enumerate(names)
    )
    return Panel(
        name="class probabilities", series=series, span=(-0.05, 1.05), is_step=True, is_output=True
    )


def find_shown_feature(line: LateralLine) -> int:
    """Return the index of the feature that ``describe_lateral_line`` shows."""
    return next((i for i, name in enumerate(line.features) if name in _PRESSURES), 0)


def _name_obstacles(config: FlowConfig) -> list[str]:
    bodies = enumerate(config.bodies[1:], 1)
    return [f"{type(body).__name__.lower()}_{index}" for index, body in bodies]


def _measure_angle(body: BodyState, *, min_speed: float, is_stream: bool) -> Tensor:
    """Return the angle ``[B]`` between heading and oncoming water, degrees.

    Without a stream along +x the water comes from where the fish swims to; NaN below ``min_speed``.
    """
    upstream = torch.full_like(body.heading, pi)
    if not is_stream:
        x, y = body.velocity.unbind(-1)
        is_slow = (x * x + y * y).sqrt() < min_speed
        upstream = torch.atan2(y, x).masked_fill(is_slow, torch.nan)
    angle = body.heading - upstream
    return torch.rad2deg(torch.atan2(torch.sin(angle), torch.cos(angle)))
