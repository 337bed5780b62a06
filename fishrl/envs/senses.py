"""Senses: what a policy in a stream observes, by name.

A task lists names in ``observes``; the observation joins what they read, in that order.
"""

from collections.abc import Callable
from math import pi
from typing import Literal, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.extensions import HasFlowLabels
from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.sensors import wrap_angle
from fishrl.envs.streams import AbstractStreamTask
from fishrl.physics.bodies.state import BodyState

SenseName = Literal[
    "place",
    "drift",
    "heading",
    "own_motion",
    "tail_beat",
    "water_velocity",
    "lateral_line",
    "flow_label",
]


DEFAULT_SENSES: tuple[SenseName, ...] = (
    "place",
    "drift",
    "water_velocity",
    "tail_beat",
    "flow_label",
)


class Sense(NamedTuple):
    """A part of the observation."""

    words: str  #: what it is, for people
    size: int  #: how many numbers it has
    read: Callable[[TensorDictBase], Tensor]  #: returns them, ``[B, size]``, from a measurement


#: Powers of the stream speed in the lateral line's features; those not listed are not scaled.
_POWERS = dict.fromkeys(("u_x", "u_y", "speed", "ahead", "left", "slip", "shear"), 1)
_POWERS |= {"p": 2, "pressure": 2}


def list_senses(line: LateralLine, *, stream_speed_bl: float) -> dict[str, Sense]:
    """Return all senses of a fish with this lateral line.

    ``own_motion`` is what a fish can feel of itself: sine and cosine of the phase of its tail beat,
    bend (L, positive to the left), frequency (beats per T) and yaw rate (radians per T).
    ``lateral_line`` holds the latest signal of each neuromast and its change since the last
    decision, velocities divided by the speed U of the fastest stream and pressures by its square.
    ``flow_label`` is appended by a transform, after all others.

    Args:
        line: the neuromasts.
        stream_speed_bl: U in L / T.
    """
    units = [stream_speed_bl ** _POWERS.get(name, 0) for name in line.features]

    def read_lateral_line(now: TensorDictBase) -> Tensor:
        signal, before = now["lateral_line"][:, -1], now["lateral_line_before"]
        both = torch.stack((signal, signal - before), 1).unbind(-1)
        return torch.stack(
            [part / unit for part, unit in zip(both, units, strict=True)], -1
        ).flatten(1)

    num_signals = (1 if line.is_averaged else line.num_neuromasts) * len(line.features)
    return {
        "place": Sense("place", 2, lambda now: now["place"]),
        "drift": Sense("drift", 2, lambda now: now["drift"]),
        "heading": Sense("heading", 1, lambda now: now["facing"][:, None]),
        "own_motion": Sense("own motion", 5, lambda now: now["own_motion"]),
        "tail_beat": Sense("tail beat", 1, lambda now: now["frequency"][:, None]),
        "water_velocity": Sense(
            "velocity at the lateral line", 2, lambda now: now["velocity"].mean(1)
        ),
        "lateral_line": Sense("lateral line", 2 * num_signals, read_lateral_line),
        "flow_label": Sense("flow label", 0, lambda now: now["place"][:, :0]),
    }


def measure_own_motion(body: BodyState, period: int) -> dict[str, Tensor]:
    """Return the entries of a measurement that ``heading`` and ``own_motion`` read.

    ``facing`` ``[B]`` is the angle of the body from upstream (-x), radians, and ``yaw_rate``
    ``[B]`` its rate in radians per T; ``period`` is T in steps.
    """
    yaw_rate, wave = body.angular_velocity * period, (body.phase.sin(), body.phase.cos())
    return {
        "facing": wrap_angle(body.heading + body.internal_angle - pi),
        "yaw_rate": yaw_rate,
        "own_motion": torch.stack((*wave, -body.bend, body.frequency * period, yaw_rate), -1),
    }


class AbstractSensingTask(AbstractStreamTask, HasFlowLabels):
    """Base of tasks in a stream whose policy observes the senses that it lists.

    Args:
        reads_flow_class: select the row of frequencies by ``flow_class``, which a transform writes,
            instead of by the true flow.
        observes: what the policy observes, in this order, see ``list_senses``; the label is that
            of a ``transforms.FlowLabelTransform``. A name may be repeated.
        lateral_line: the neuromasts.
    """

    reads_flow_class: bool = False
    observes: tuple[SenseName, ...] = DEFAULT_SENSES
    lateral_line: LateralLine = LateralLine()

    def __post_init__(self) -> None:
        if not self.n_obs:
            raise ValueError(f"observes = {self.observes}: name a sense other than flow_label")
        super().__post_init__()

    @property
    def n_obs(self) -> int:
        """Length of one observation."""
        return sum(sense.size for sense in self._list_observed())

    @property
    def num_label_inputs(self) -> int:
        """One per flow, or none."""
        return len(self.flow_labels) if "flow_label" in self.observes else 0

    @property
    def senses(self) -> tuple[str, ...]:
        """What is observed, in words."""
        used = [sense for sense in self._list_observed() if sense.size or self.reads_flow_class]
        return tuple(dict.fromkeys(sense.words for sense in used))

    def observe(self, now: TensorDictBase) -> Tensor:
        """Return what the senses read."""
        return torch.cat([sense.read(now).float() for sense in self._list_observed()], -1)

    def _list_observed(self) -> list[Sense]:
        speed = self.max_stream_speed_bl
        senses = list_senses(self.lateral_line, stream_speed_bl=speed)
        return [senses[name] for name in self.observes]
