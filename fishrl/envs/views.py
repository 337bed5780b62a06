"""What is drawn of every task: the flow, the bodies and forces, the edges, reward and action."""

import re
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.extensions import HasScene, find_extension
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.scene import Area, Arrow, Choice, Curve, Field, Marks, Panel, Scene, Series, Trail
from fishrl.envs.task import AbstractTask
from fishrl.physics.bodies.fish import Fish
from fishrl.physics.diagnostics import compute_pressure
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.flow import FlowConfig
from fishrl.physics.units import Scales

#: Fields of every scene.
FIELDS = ("vorticity", "pressure", "speed")
FISH, MIDLINE, OBSTACLE = (32, 37, 43), (240, 240, 240), (110, 110, 110)
PATCH = (150, 110, 170)
#: Length of an arrow for a force of rho U^2 L, body lengths, with the fastest stream U.
_FORCE_BL = 3.0
_SEPARATOR = " · "  # of the parts of a title
_STREAM_BL = 0.5  # length of an arrow for a stream of 1 L / T, body lengths
#: Substitute for U in still water, L / T: about the speed of a fish.
_SWIMMING = 0.5
#: Below this speed, L / T, neither a stream nor a fish has a direction.
_MIN_SPEED = 0.05
_PRESSURES = ("pressure", "p")
#: Units of features of a neuromast other than pressures and velocities, and the values at which
#: their colours saturate.
_FEATURES = {
    "t": ("T", 10.0), "x": ("L", 10.0), "y": ("L", 5.0), "shear": ("1/T", 50.0),
}  # fmt: skip
_SIDES = ("right", "left")
#: Names of bodies other than the fish that decide.
_WORDS = {"dcylinder": "half disc", "fish": "leader"}


def make_scene(task: AbstractTask, *, shows_levels: bool = False) -> Scene:
    """Return the scene to draw of a task: the flow, its bodies and edges, reward and action.

    The first bodies are fish; with several, plots have a line for each. A task with ``HasScene``
    adds to it. With ``shows_levels`` there are the outlines of finer grids, and dots where their
    lower left corners have been.
    """
    extension = find_extension(task, HasScene)
    config, scales, num_fish = task.flow_config(), task.scales, task.num_fish
    obstacles, margin = _name_obstacles(config), task.wall_margin
    patches, shifts = _draw_patches(config) if shows_levels else ((), ())
    (left, bottom), (right, top) = config.edges
    force_bl = _FORCE_BL / _find_fastest(config, scales) ** 2
    edges = Area(
        key="edges",
        low=(left + margin, bottom + margin),
        high=(right - margin, top - margin),
    )
    scene = Scene(
        body_length=float(scales.body_length),
        width=config.width,
        height=config.height,
        title=_describe(task, extension),
        fields=make_fields(config, scales),
        curves=(*_draw_bodies(num_fish, obstacles), *patches),
        arrows=_draw_arrows(config, scales.body_length, ["fish", *obstacles], force_bl=force_bl),
        trails=(*(Trail(key=name_fish("head", i)) for i in range(num_fish)), *shifts),
        areas=(edges,),
        panels=(
            Panel(
                name="reward r, as ±log₂(1 + |r|)",
                series=plot_fish("reward", "reward", num_fish),
                is_step=True,
                is_output=True,
                is_log=True,
            ),
            *_describe_actions(task, extension.action_names),
            *_plot_motion(num_fish, ["fish", *obstacles]),
        ),
        note="Angle of attack: from upstream to the heading; in still water from the direction of "
        "swimming. Power of the muscles and force: means since the previous frame. Arrows: the "
        f"force now, {force_bl:.3g} L for 1 ρ L³/T².",
    )
    return extension.add_to_scene(scene)


def _draw_bodies(num_fish: int, obstacles: Sequence[str]) -> tuple[Curve, ...]:
    """Return the outlines of all bodies, and the midlines of the fish."""
    looks: dict[str, Any] = {"colour": MIDLINE, "is_closed": False, "order": 5.0}
    words = [f"fish {i}" for i in range(num_fish)] if num_fish > 1 else ["fish"]
    kinds = {key: key.rpartition("_")[0] for key in obstacles[num_fish - 1 :]}
    return (
        *(Curve(key=name_fish("fish", i), colour=FISH, name=word) for i, word in enumerate(words)),
        *(Curve(key=name_fish("midline", i), **looks) for i in range(num_fish)),
        *(Curve(key=k, colour=OBSTACLE, name=_WORDS.get(kind, kind)) for k, kind in kinds.items()),
    )


def _draw_patches(config: FlowConfig) -> tuple[tuple[Curve, ...], tuple[Trail, ...]]:
    """Return the outlines of finer grids, and where shifts have brought them."""
    names = [f"patch_{number}" for number in range(1, len(config.list_grids()))]
    dots = (Trail(key=f"{name}_corner", colour=PATCH, is_dotted=True) for name in names)
    looks: dict[str, Any] = {"colour": PATCH, "is_filled": False, "order": 3.0}
    return tuple(Curve(key=key, name="finer grid", **looks) for key in names), tuple(dots)


def read_patches(solver: InPlaceSolver) -> dict[str, Tensor]:
    """Return the corners ``[B, 4, 2]`` of finer grids, counter-clockwise from the lower left."""
    corners, found = solver.corners.double(), dict[str, Tensor]()
    around = corners.new_tensor([[0, 0], [1, 0], [1, 1], [0, 1]])
    for number, (width, height, spacing) in enumerate(solver.config.list_grids()[1:], 1):
        size = spacing * corners.new_tensor([width - 1, height - 1])
        found[f"patch_{number}"] = corners[:, number, None] + size * around
    return found


def _draw_arrows(
    config: FlowConfig, length: float, bodies: Sequence[str], *, force_bl: float
) -> tuple[Arrow, ...]:
    """Return the forces on bodies, and the stream in the lower left corner."""
    stream = Arrow(
        key="stream",
        at=(0.02 * config.width, 0.06 * config.height),
        scale=_STREAM_BL * length,
        colour=FISH,
        name="stream",
        unit="L/T",
    )
    forces = (
        Arrow(key=f"{body}_force", at=f"{body}_centre", scale=force_bl * length) for body in bodies
    )
    return (*forces, stream)


def _plot_motion(num_fish: int, bodies: Sequence[str]) -> tuple[Panel, ...]:
    """Return the plots of tail beat, angle of attack and power of each fish, and of forces."""
    forces = tuple(
        Series(key=f"{body}_impulse", column=column, label=f"{body}, {axis}", is_rate=True)
        for body in bodies
        for column, axis in enumerate("xy")
    )
    beat = plot_fish("frequency", "frequency", num_fish)
    angle = plot_fish("angle_of_attack", "angle", num_fish)
    power = plot_fish("work", "power", num_fish, is_rate=True)
    return (
        Panel(name="tail-beat frequency [1/T]", series=beat, is_step=True),
        Panel(name="angle of attack [°]", series=angle),
        Panel(name="power [ρ L⁴/T³]", series=power, is_step=True),
        Panel(name="force of the fluid [ρ L³/T²]", series=forces, is_step=True),
    )


def _describe(task: AbstractTask, extension: HasScene) -> str:
    """Return a task's name and senses."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", type(task).__name__).capitalize()
    names = ", ".join(dict.fromkeys(sense.name for sense in task.senses))
    senses = f"senses: {names}" if names else ""
    return _SEPARATOR.join(filter(None, (extension.title or words, senses)))


def name_fish(key: str, number: int) -> str:
    """Return the key of a drawn part of one fish; the first fish has no number."""
    return f"{key}_{number}" if number else key


def plot_fish(key: str, label: str, num_fish: int, *, is_rate: bool = False) -> tuple[Series, ...]:
    """Return a line for each fish."""
    labels = [f"{label}, fish {i}" for i in range(num_fish)] if num_fish > 1 else [label]
    return _plot_columns(key, labels, is_rate=is_rate)


def _plot_columns(key: str, labels: Sequence[str], *, is_rate: bool = False) -> tuple[Series, ...]:
    """Return a line for each column of a tensor."""
    return tuple(
        Series(key=key, column=i, label=label, is_rate=is_rate) for i, label in enumerate(labels)
    )


def _describe_actions(task: AbstractTask, names: tuple[str, ...]) -> tuple[Panel | Choice, ...]:
    """Return the plots of the actions: one for each fish, or one of all continuous numbers."""
    num_fish = task.num_fish
    names = names or tuple(f"action {index}" for index in range(task.num_actions))
    owners = [f"fish {i}: " for i in range(num_fish)] if num_fish > 1 else [""]
    if task.action_bounds is not None:
        labels = [owner + name for owner in owners for name in names]
        panel = Panel(
            name="action, from the least (−1) to the largest (1)",
            series=_plot_columns("action", labels),
            span=(-1.1, 1.1),
            is_step=True,
            is_output=True,
        )
        return (panel,)
    if num_fish == 1:
        return (Choice(names=names),)
    return tuple(
        Choice(names=names, fish=i, name=owner + Choice.name) for i, owner in enumerate(owners)
    )


def make_fields(config: FlowConfig, scales: Scales) -> tuple[Field, ...]:
    """Return the fields that ``compute_fields`` gives, with limits that suit the fastest stream."""
    speed = _find_fastest(config, scales)
    return (
        Field(
            key="vorticity",
            name="vorticity",
            unit="1/T",
            limit=15.0,
            note="positive: counter-clockwise",
            saturated=0.2,
        ),
        Field(
            key="pressure",
            name="pressure",
            unit="ρ (L/T)²",
            limit=speed**2,
            note="above the pressure at rest",
            saturated=0.02,
        ),
        Field(key="speed", name="speed", unit="L/T", limit=1.5 * speed, is_signed=False),
    )


def compute_fields(
    solver: InPlaceSolver,
    scales: Scales,
    *,
    keys: Sequence[str] = FIELDS,
    rows: Tensor | None = None,
) -> dict[str, Tensor]:
    """Return fields ``[B, Y, X]`` of ``make_fields``, float16; 0 in flows outside ``rows``."""
    unit = scales.reference_speed
    read = {
        "vorticity": lambda: solver.vorticity(rows) * scales.period,
        "pressure": lambda: compute_pressure(solver.macroscopic(rows)[0]) / unit**2,
        "speed": lambda: torch.hypot(*solver.macroscopic(rows)[1].unbind(1)) / unit,
    }
    fields = {key: read[key]().half() for key in keys}
    if rows is not None:
        for key, field in fields.items():
            fields[key] = field.new_zeros(len(rows), *field.shape[1:])
            fields[key][rows] = field
    return fields


def read_scene(
    task: AbstractTask,
    solver: InPlaceSolver,
    starts: TensorDictBase,
    *,
    fields: Sequence[str] = FIELDS,
    rows: Tensor | None = None,
) -> dict[str, Tensor]:
    """Return ``[B, ...]`` tensors by the keys of ``make_scene``; numbers of M fish ``[B, M]``.

    Of the fields only those of ``fields`` are read, and those of the flows in ``rows`` ``[B]``,
    by default all; in others they are 0.
    """
    extension = find_extension(task, HasScene)
    scales, num_fish = task.scales, task.num_fish
    values = compute_fields(solver, scales, keys=fields, rows=rows)
    patches = read_patches(solver)
    values |= patches | {f"{name}_corner": corners[:, 0] for name, corners in patches.items()}
    for index, name in enumerate(("fish", *_name_obstacles(solver.config))):
        values |= _read_body(solver, index, name, scales)
    every = [_read_fish(solver, index, scales) for index in range(num_fish)]
    for index, own in enumerate(every):
        for key in ("midline", "head"):
            values[name_fish(key, index)] = own.pop(key)
    numbers = {key: torch.stack([own[key] for own in every], -1) for key in every[0]}
    values |= numbers if num_fish > 1 else every[0]
    inflow = solver.stream_speed.new_tensor(solver.config.inflow) / scales.reference_speed
    values["stream"] = solver.stream_speed[:, None] * inflow
    return values | extension.read_scene(solver, starts)


def _read_fish(solver: InPlaceSolver, index: int, scales: Scales) -> dict[str, Tensor]:
    """Return midline and nose of a fish, and its numbers ``[B]``."""
    body, markers, length = solver.bodies[index], solver.markers(index), scales.body_length
    heading = body.heading
    if 2 in solver.config.bodies[index].motion.free_axes:  # the beat alone turns it to and fro
        heading = heading + body.internal_angle
    half = markers.shape[1] // 2
    other_side = -torch.arange(half + 1, device=markers.device) % markers.shape[1]
    return {
        "midline": 0.5 * (markers[:, : half + 1] + markers[:, other_side]),
        "head": markers[:, 0],
        "heading": heading,
        "frequency": body.frequency * scales.period,
        "work": body.work / (length * length / scales.period) ** 2,
        "angle_of_attack": _measure_angle(
            heading,
            body.velocity,
            stream=solver.stream_speed[:, None] * body.velocity.new_tensor(solver.config.inflow),
            min_speed=_MIN_SPEED * scales.reference_speed,
        ),
    }


def describe_lateral_line(
    line: LateralLine, *, body_length: float, speed: float = _SWIMMING
) -> tuple[Marks, Panel]:
    """Return neuromasts coloured by what they sense, and a plot of it; keys: neuromasts, signal.

    Of several features it is the pressure, or the first one. Colours of pressures and velocities
    suit a stream of this speed, L / T.
    """
    feature = line.features[find_shown_feature(line)]
    if feature in _PRESSURES:
        unit, limit = "ρ (L/T)²", speed**2
    else:
        unit, limit = _FEATURES.get(feature, ("L/T", 1.5 * speed))
    names = name_neuromasts(line.num_neuromasts)
    marks = Marks(
        key="neuromasts",
        radius=2.0 * body_length / 50.0,
        value="signal",
        name=f"{feature} at neuromasts",
        unit=unit,
        limit=limit,
    )
    series = _plot_columns("signal", names)
    return marks, Panel(name=f"{feature} at neuromasts [{unit}]", series=series)


def name_neuromasts(num: int) -> list[str]:
    """Return the names of P neuromasts, "nose", "right 1" etc., as ``LateralLine`` orders them."""
    pairs = [f"{side} {k}" for k in range(1, num // 2 + 1) for side in _SIDES]
    return ["nose"] * (num % 2) + pairs


def describe_flow_label(names: Sequence[str]) -> Panel:
    """Return a plot of the probabilities that a transform gives to flows of these names."""
    return Panel(
        name="class probabilities",
        series=_plot_columns("flow_probabilities", names),
        span=(-0.05, 1.05),
        is_step=True,
        is_output=True,
    )


def find_shown_feature(line: LateralLine) -> int:
    """Return the index of the feature that ``describe_lateral_line`` shows."""
    return next((i for i, name in enumerate(line.features) if name in _PRESSURES), 0)


def _find_fastest(config: FlowConfig, scales: Scales) -> float:
    """Return the speed that sets the scale of pressures and forces, L / T."""
    return max(_SWIMMING, config.fastest_edge / scales.reference_speed)


def _name_obstacles(config: FlowConfig) -> list[str]:
    return [
        f"{'fish' if isinstance(body, Fish) else type(body).__name__.lower()}_{index}"
        for index, body in enumerate(config.bodies[1:], 1)
    ]


def _read_body(solver: InPlaceSolver, index: int, name: str, scales: Scales) -> dict[str, Tensor]:
    """Return outline and centre of a body, the force on it and its time integral."""
    body, length = solver.bodies[index], scales.body_length
    force = length * scales.reference_speed**2  # per unit depth
    return {
        name: solver.markers(index),
        f"{name}_centre": body.position,
        f"{name}_force": body.hydro_force / force,
        f"{name}_impulse": body.impulse / (force * scales.period),
    }


def _measure_angle(
    heading: Tensor, velocity: Tensor, *, stream: Tensor, min_speed: float
) -> Tensor:
    """Return the angle ``[B]`` between heading and oncoming water, degrees.

    It comes from upstream of ``stream`` ``[B, 2]``; in still water from where the fish swims to.
    NaN below ``min_speed``, nodes per step.
    """
    is_stream = stream.norm(dim=-1, keepdim=True) >= min_speed
    x, y = torch.where(is_stream, -stream, velocity).unbind(-1)
    is_slow = torch.hypot(x, y) < min_speed
    angle = heading - torch.atan2(y, x).masked_fill(is_slow, torch.nan)
    return torch.rad2deg(torch.atan2(torch.sin(angle), torch.cos(angle)))
