"""Senses of a fish in a stream, which ``KarmanGait(observes=...)`` joins in the given order."""

from collections.abc import Mapping
from functools import cache
from math import pi
from types import MappingProxyType
from typing import Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.lateral_line import LateralLine
from fishrl.envs.sense import Sense
from fishrl.envs.sensors import wrap_angle
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


#: What a fish feels of itself, see ``measure_own_motion``.
OWN_SENSES = {
    "heading": Sense(
        "heading", ("from upstream [rad]",), lambda now: now["facing"][:, None], (-1,)
    ),
    "own_motion": Sense(
        "own motion",
        (
            "sine of the phase of the tail beat",
            "cosine of the phase",
            "bend, positive to the left [L]",
            "frequency [1/T]",
            "yaw rate, positive to the left [rad/T]",
        ),
        lambda now: now["own_motion"],
        (-1, -2, -3, 4, -5),  # the mirrored beat is half a period ahead
    ),
}
#: Features of a neuromast whose mirror image, at the neuromast opposite, has the other sign: across
#: the fish, and along the outline, which runs backwards then. The absolute y has none.
REVERSED = ("u_y", "left", "shear")
#: Powers of the speed U of the stream that the lateral line's features are divided by, and units.
_SCALES = {"t": (0, "T"), "x": (0, "L"), "y": (0, "L"), "shear": (1, "U/L")}
_SCALES |= dict.fromkeys(("u_x", "u_y", "speed", "ahead", "left", "slip"), (1, "U"))
_SCALES |= dict.fromkeys(("p", "pressure"), (2, "ρ U²"))


@cache
def list_senses(line: LateralLine, *, stream_speed_bl: float) -> Mapping[str, Sense]:
    """Return all senses of a fish with this lateral line.

    ``lateral_line`` holds the latest signal of each neuromast and its change since the last
    decision, velocities divided by the speed U of the fastest stream and pressures by its square.
    ``flow_label`` is appended by a transform, after all others.

    Args:
        line: the neuromasts.
        stream_speed_bl: U in L / T.
    """
    scales = [stream_speed_bl ** _SCALES[name][0] for name in line.features]

    def read_lateral_line(now: TensorDictBase) -> Tensor:
        signal, before = now["lateral_line"][:, -1], now["lateral_line_before"]
        both = torch.stack((signal, signal - before), 1).unbind(-1)
        return torch.stack(
            [part / scale for part, scale in zip(both, scales, strict=True)], -1
        ).flatten(1)

    signals = [
        f"{what}{name} at neuromast {number} [{_SCALES[name][1]}]"
        for what in ("", "change of ")
        for number in range(1 if line.is_averaged else line.num_neuromasts)
        for name in line.features
    ]
    every = {
        **OWN_SENSES,
        "place": Sense("place", ("x [L]", "y [L]"), lambda now: now["place"], (1, -2)),
        "drift": Sense("drift", ("Δx [L]", "Δy [L]"), lambda now: now["drift"], (1, -2)),
        "tail_beat": Sense(
            "tail beat", ("frequency [1/T]",), lambda now: now["frequency"][:, None], (1,)
        ),
        "water_velocity": Sense(
            "velocity at the lateral line",
            ("u_x [L/T]", "u_y [L/T]"),
            lambda now: now["velocity"].mean(1),
            (1, -2),
        ),
        "lateral_line": Sense(
            "lateral line", tuple(signals), read_lateral_line, _mirror_lateral_line(line)
        ),
        "flow_label": Sense("flow label", (), lambda now: now["place"][:, :0], ()),
    }
    return MappingProxyType(every)


def _mirror_lateral_line(line: LateralLine) -> tuple[int, ...] | None:
    """Return its mirror image: right and left neuromasts change places."""
    if "y" in line.features:
        return None
    num = 1 if line.is_averaged else line.num_neuromasts
    first = num % 2  # one at the nose, then pairs
    opposite = [*range(first), *(first + ((p - first) ^ 1) for p in range(first, num))]
    return tuple(
        (-1 if name in REVERSED else 1) * (1 + (part * num + p) * len(line.features) + f)
        for part in (0, 1)
        for p in opposite
        for f, name in enumerate(line.features)
    )


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
