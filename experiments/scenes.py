"""What there is to see in a task, found out from what the task has, and how it is read off the env.

Each ``_see_...`` below looks at one thing that a task may have; a task of one's own shows whatever
of it it shares, without another line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.macro_actions import DirectFrequencies, MacroActions
from fishrl.physics.diagnostics import compute_vorticity
from fishrl.viewer import Area, Choice, Field, Marks, Outline, Panel, Scene, Series, Trail

Values = dict[str, Tensor]
#: Read off an env: it, and what it measures now.
Read = Callable[[Any, TensorDictBase], Values]

FISH, MIDLINE, OBSTACLE = (32, 37, 43), (240, 240, 240), (110, 110, 110)
FOOD = (242, 177, 52)
#: Entries of a decision that belong to its frames, beside action and reward.
DECIDED = ("action_mask", "flow_probabilities")
#: Slower than this, L / T, a fish has no direction of swimming.
_SLOWEST = 0.05
_PRESSURES = ("pressure", "p")
#: Unit of what a neuromast tells, and the value at which its colour saturates.
_FELT = {
    **dict.fromkeys(_PRESSURES, ("ρ (L/T)²", 1.0)),
    "t": ("T", 10.0), "x": ("L", 10.0), "y": ("L", 5.0), "shear": ("1/T", 50.0),
}  # fmt: skip
_VELOCITY = ("L/T", 2.0)


@dataclass(frozen=True, kw_only=True)
class Sight:
    """What one thing adds to a scene, and how it is read.

    Args:
        read: returns tensors ``[B, ...]`` by key.
        outlines: see ``Scene``.
        marks: likewise.
        trails: likewise.
        areas: likewise.
        panels: likewise.
        note: likewise.
    """

    read: Read = lambda base, now: {}
    outlines: tuple[Outline, ...] = ()
    marks: tuple[Marks, ...] = ()
    trails: tuple[Trail, ...] = ()
    areas: tuple[Area, ...] = ()
    panels: tuple[Panel | Choice, ...] = ()
    note: str = ""


class TaskView:
    """The scene of a task, and the reader of its frames.

    Args:
        task: whose flows these are.
        is_told: whether transforms tell the fish which flow it is in.
        vorticity_limit: at which the colours saturate, 1/T.

    Attributes:
        task: the task.
        scene: what there is to see.

    Raises:
        ValueError: if the limit is not positive.
    """

    def __init__(self, task: Any, *, is_told: bool = False, vorticity_limit: float = 15.0) -> None:
        self.task = task
        config = task.flow_config()
        sights = [see(task) for see in (_see_edges, *_SEERS)]
        self._sights = [sight for sight in sights if sight is not None]
        told = (_plot_told(task),) if is_told else ()
        reward = Panel(name="reward", series=(Series(key="reward", label="reward"),), is_step=True)
        self.scene = Scene(
            body_length=float(task.scales.body_length),
            width=config.width,
            height=config.height,
            field=Field(
                key="vorticity", name="vorticity", unit="1/T", limit=vorticity_limit,
                note="positive turns counter-clockwise",
            ),
            outlines=self._collect("outlines"),
            marks=self._collect("marks"),
            trails=self._collect("trails"),
            areas=self._collect("areas"),
            panels=(reward, Choice(names=name_actions(task)), *told, *self._collect("panels")),
            note="\n\n".join(sight.note for sight in self._sights if sight.note),
        )  # fmt: skip

    def read(self, base: Any) -> Values:
        """Return what the flows of an env look like now, ``[B, ...]`` by the scene's keys."""
        now = base.measure()
        velocity = base.solver.macroscopic()[1]
        values = {"vorticity": (compute_vorticity(velocity) * self.task.scales.period).half()}
        for sight in self._sights:
            values |= sight.read(base, now)
        return values

    def name_flows(self, starts: Mapping[str, Tensor], flows: list[int]) -> dict[int, str]:
        """Return titles of flows by their index, from the starts ``[E]`` they begin with."""
        titles = {flow: f"flow {flow}" for flow in flows}
        if "flow_index" in starts and hasattr(self.task, "flow_labels"):
            labels = [label["name"] for label in self.task.flow_labels]
            titles = {
                flow: f"{title}: {labels[int(starts['flow_index'][flow])]}"
                for flow, title in titles.items()
            }
        return titles

    def _collect(self, name: str) -> tuple[Any, ...]:
        return tuple(one for sight in self._sights for one in getattr(sight, name))


def name_actions(task: Any) -> tuple[str, ...]:
    """Return what the actions of a task are called."""
    control = getattr(task, "control", None)
    if isinstance(control, MacroActions):
        return "decelerate", "cruise", "accelerate"
    if isinstance(control, DirectFrequencies):
        return tuple(f"{frequency:g} beats/T" for frequency in control.frequencies)
    turn = getattr(task, "turn_degrees", None)
    if turn is not None and task.num_actions == 3:
        return f"turn {-turn:g}°", "keep", f"turn +{turn:g}°"
    return tuple(f"action {index}" for index in range(task.num_actions))


def _see_edges(task: Any) -> Sight:
    """See how near to the edges a fish may come."""
    config, margin = task.flow_config(), task.wall_margin
    area = Area(
        key="edges",
        low=(margin, margin),
        high=(config.width - 1.0 - margin, config.height - 1.0 - margin),
    )
    return Sight(areas=(area,))


def _see_station(task: Any) -> Sight | None:
    """See the area in which a fish holds its station."""
    if not hasattr(task, "safe_area") or not hasattr(task, "origin"):
        return None
    (x, y), length, area = task.origin.tolist(), task.body_length, task.safe_area
    aside = area.aside_bl * length
    box = Area(
        key="danger_area",
        low=(x + area.near_bl * length, y - aside),
        high=(x + area.far_bl * length, y + aside),
    )
    series = (
        Series(key="place", column=0, label="x, downstream"),
        Series(key="place", column=1, label="y"),
    )
    return Sight(
        read=lambda base, now: {"place": now["place"]},
        areas=(box,),
        panels=(Panel(name="nose from the flat side [L]", series=series),),
        note="The danger area is where the red strokes point: outside the rectangle.",
    )


def _see_obstacles(task: Any) -> Sight | None:
    """See the bodies beside the fish."""
    others = task.flow_config().bodies[1:]
    if not others:
        return None
    keys = [f"{type(body).__name__.lower()}_{index}" for index, body in enumerate(others, 1)]

    def read(base: Any, now: TensorDictBase) -> Values:
        there = range(1, len(base.solver.bodies))
        return {keys[index - 1]: base.solver.markers(index) for index in there}

    return Sight(read=read, outlines=tuple(Outline(key=key, colour=OBSTACLE) for key in keys))


def _see_food(task: Any) -> Sight | None:
    """See the food, and how far it is."""
    if not hasattr(task, "locate_food"):
        return None
    length = task.body_length

    def read(base: Any, now: TensorDictBase) -> Values:
        food = task.locate_food(base.start, base.solver.body.age)
        distance = (food - base.solver.head()).norm(dim=-1) / length
        return {"food": food, "distance": distance}

    food = Marks(
        key="food", radius=3.0 * length / 50.0, colour=FOOD, reach=float(task.capture_radius)
    )
    series = (Series(key="distance", label="nose to food"),)
    return Sight(
        read=read,
        marks=(food,),
        panels=(Panel(name="distance of the food [L]", series=series),),
        note="The circle round the food is the capture radius.",
    )


def _see_fish(task: Any) -> Sight:
    """See the fish, its midline and its way; its beat, angle of attack and power."""
    length, period = task.scales.body_length, task.scales.period
    unit = float(length * length / period) ** 2
    is_stream = hasattr(task, "stream")

    def read(base: Any, now: TensorDictBase) -> Values:
        body, markers = base.solver.body, base.solver.markers()
        half = markers.shape[1] // 2
        other_side = -torch.arange(half + 1, device=markers.device) % markers.shape[1]
        return {
            "fish": markers,
            "midline": 0.5 * (markers[:, : half + 1] + markers[:, other_side]),
            "head": markers[:, 0],
            "heading": body.heading,
            "frequency": body.frequency * period,
            "work": body.work / unit,
            "angle_of_attack": _measure_angle(body, length / period, is_stream=is_stream),
        }

    plots = (
        ("tail-beat frequency [1/T]", Series(key="frequency", label="frequency"), True),
        ("angle of attack [°]", Series(key="angle_of_attack", label="angle"), False),
        ("power [ρ L⁴/T³]", Series(key="work", label="power", is_rate=True), True),
    )
    return Sight(
        read=read,
        outlines=(
            Outline(key="fish", colour=FISH),
            Outline(key="midline", colour=MIDLINE, is_closed=False, order=5.0),
        ),
        trails=(Trail(key="head"),),
        panels=tuple(Panel(name=name, series=(line,), is_step=step) for name, line, step in plots),
        note="Angle of attack: of the heading, from upstream; in still water from where the fish "
        "swims. Power: what the muscles do, mean since the frame before.",
    )


def _measure_angle(body: Any, unit: float, *, is_stream: bool) -> Tensor:
    """Return the angle ``[B]`` between heading and oncoming water, degrees; NaN at rest.

    Args:
        body: the fish.
        unit: L / T in nodes per step.
        is_stream: whether the water comes along +x; otherwise it is still.
    """
    upstream = torch.full_like(body.heading, pi)
    if not is_stream:
        x, y = body.velocity.unbind(-1)
        is_slow = (x * x + y * y).sqrt() < _SLOWEST * unit
        upstream = torch.atan2(y, x).masked_fill(is_slow, torch.nan)
    angle = body.heading - upstream
    return torch.rad2deg(torch.atan2(torch.sin(angle), torch.cos(angle)))


def _see_lateral_line(task: Any) -> Sight | None:
    """See the neuromasts, and what they feel."""
    line = getattr(task, "lateral_line", None)
    if line is None:
        return None
    index = next((i for i, name in enumerate(line.features) if name in _PRESSURES), 0)
    feature = line.features[index]
    unit, limit = _FELT.get(feature, _VELOCITY)

    def read(base: Any, now: TensorDictBase) -> Values:
        points = line.place(base.solver)[0]
        felt = task.sense(base.solver, base.start)["felt"][..., index]
        return {"neuromasts": points, "felt": felt.expand(points.shape[:2])}

    marks = Marks(
        key="neuromasts", radius=2.0 * task.body_length / 50.0, value="felt",
        name=f"{feature} felt", unit=unit, limit=limit,
    )  # fmt: skip
    names = _name_neuromasts(line.num_neuromasts)
    series = tuple(Series(key="felt", column=i, label=name) for i, name in enumerate(names))
    return Sight(
        read=read, marks=(marks,), panels=(Panel(name=f"{feature} felt [{unit}]", series=series),)
    )


def _name_neuromasts(num: int) -> list[str]:
    """Name neuromasts in the order of ``LateralLine.place``."""
    pairs = [f"{side} {pair}" for pair in range(1, num // 2 + 1) for side in ("right", "left")]
    return ["nose"] * (num % 2) + pairs


def _plot_told(task: Any) -> Panel:
    """Plot which flow the fish is told it is in."""
    series = tuple(
        Series(key="flow_probabilities", column=index, label=label["name"])
        for index, label in enumerate(task.flow_labels)
    )
    return Panel(name="class probabilities", series=series, span=(-0.05, 1.05), is_step=True)


_SEERS: tuple[Callable[[Any], Sight | None], ...] = (
    *(_see_fish, _see_lateral_line, _see_station, _see_obstacles, _see_food),
)
