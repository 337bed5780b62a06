"""Heading controllers: they turn the fish while a policy chooses its tail-beat frequency.

Without one, a fish in a wake turns broadside within a few T and is swept away. Once per control
interval the controller observes position and heading and commands a turn from its latest
observations; the body turns smoothly over the interval. The fish faces upstream at heading pi.
"""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import field
from functools import cache, cached_property
from itertools import pairwise
from math import pi, radians
from pathlib import Path
from typing import Annotated, ClassVar

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from torch import Tensor
from torch.nn.functional import relu

from fishrl.envs.sensors import sense_target, wrap_angle
from fishrl.files import load_tensors
from fishrl.settings import Settings

_PACKAGED = Path(__file__).with_name("steering.pt")


class Steering(ABC):
    """A heading controller without state: the environment keeps its observations.

    Attributes:
        num_stacked: S, number of latest observations it reads, the current one included.
        decisions_per_T: the control rate it needs; None if it works at any.
        has_mirror: whether the mirror image of its turn is its turn in the mirrored flow.
    """

    num_stacked: int
    decisions_per_T: int | None = None
    has_mirror: ClassVar[bool] = False

    @property
    @abstractmethod
    def largest_turn(self) -> float:
        """Largest turn within one interval, radians."""

    @abstractmethod
    def observe(self, nose: Tensor, middle: Tensor, heading: Tensor) -> Tensor:
        """Return its observation ``[B, n]``, float64.

        ``nose`` and ``middle``, the mean of the outline, are places ``[B, 2]``, x downstream, y
        from the centreline, in body lengths; ``heading`` ``[B]`` is in radians.
        """

    @abstractmethod
    def turn(self, observations: Tensor) -> Tensor:
        """Return the change of heading ``[B]`` in radians over the coming interval.

        The observations ``[B, S, n]`` come oldest first; before an episode its first one is
        repeated.
        """


class PIDSteering(Settings, Steering):
    """PID control of the lateral position: aim upstream, and back towards the centreline.

    The controlled point is the body's middle: the nose sways with every beat, and sampled about
    once per beat its sway shows up as an apparent drift. The target heading differs from upstream
    by gain times the lateral offset, integral gain times its mean over all observations, and
    damping times its change, in radians per body length; the turn towards it is bounded. Without
    the mean, a steady lateral pull in a wake leaves a constant offset.

    Args:
        num_stacked: S, observations that the mean is over, one per decision; at least 2.
        gain: radians per body length of offset.
        integral_gain: radians per body length of the mean offset.
        damping: radians per body length that the offset grew within the last interval.
        max_angle_degrees: largest angle between target heading and upstream.
        max_turn_degrees: largest turn in one interval.
    """

    has_mirror = True

    num_stacked: Annotated[int, Field(ge=2)] = 32
    gain: NonNegativeFloat = 1.0
    integral_gain: NonNegativeFloat = 1.0
    damping: NonNegativeFloat = 0.0
    max_angle_degrees: Annotated[float, Field(gt=0, le=90)] = 15.0
    max_turn_degrees: Annotated[float, Field(gt=0, le=90)] = 15.0

    @property
    def largest_turn(self) -> float:
        """Largest turn, radians."""
        return radians(self.max_turn_degrees)

    def observe(self, nose: Tensor, middle: Tensor, heading: Tensor) -> Tensor:
        """Return the lateral offset of the middle, and the heading."""
        return torch.stack((middle[:, 1], heading), -1)

    def turn(self, observations: Tensor) -> Tensor:
        """Return the bounded turn towards the target heading."""
        offsets, heading = observations[..., 0], observations[:, -1, 1]
        offset, before = offsets[:, -1], offsets[:, -2]
        most, step = radians(self.max_angle_degrees), self.largest_turn
        # a heading above pi points down, so a fish that is too high turns counter-clockwise
        aim = self.gain * offset + self.integral_gain * offsets.mean(1)
        aim = aim + self.damping * (offset - before)
        return wrap_angle(pi + aim.clamp(-most, most) - heading).clamp(-step, step)


class PolicySteering(Settings, Steering):
    """Steer with the network that learned to catch food, towards a point upstream.

    It acts greedily: turn clockwise, keep, turn counter-clockwise. The point lies ahead of the
    fish, as food would, on the centreline. At several decisions per T the network reads
    observations one T apart, as in training, and each turn is divided by their number.

    Args:
        path: file for ``load_weights``; by default that of the package, of a policy trained on
            ``Predation`` in still water at L = 50.
        turn_degrees: turn per T.
        ahead_bl: distance of the point upstream of the nose, body lengths.
        decisions_per_T: the control rate; it learned with one.
        weights: SHA-256 of the file, which settings keep, and which stands for the path in keys of
            kept results; another one is refused.
    """

    path: str = field(default="", repr=False)
    turn_degrees: Annotated[float, Field(ge=0, le=180)] = 15.0
    ahead_bl: PositiveFloat = 2.0
    decisions_per_T: PositiveInt = 4
    weights: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if Path(self.path).parts[-3:] == _PACKAGED.parts[-3:]:  # of a run of an earlier version
            object.__setattr__(self, "path", "")
        _ = self.layers  # raises if the file holds something else
        found = hashlib.sha256(self.file.read_bytes()).hexdigest()
        if self.weights not in ("", found):
            raise ValueError(
                f"weights = {self.weights}: {self.file} has others, {found}; give the path of the "
                "former file, or leave weights out"
            )
        object.__setattr__(self, "weights", found)

    @property
    def file(self) -> Path:
        """Path of the file."""
        return Path(self.path).expanduser() if self.path else _PACKAGED

    @property
    def num_stacked(self) -> int:  # type: ignore[override]
        """Number of observations in four T."""
        return 4 * self.decisions_per_T

    @property
    def largest_turn(self) -> float:
        """Turn of each interval in which the fish turns, radians."""
        return radians(self.turn_degrees) / self.decisions_per_T

    @cached_property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weight and bias of each layer."""
        return load_weights(self.file)

    def observe(self, nose: Tensor, middle: Tensor, heading: Tensor) -> Tensor:
        """Return the point as food is observed, see ``sensors.sense_target``."""
        ahead = torch.stack((nose[:, 0] - self.ahead_bl, torch.zeros_like(heading)), -1)
        return sense_target(nose, heading, ahead, body_length=1.0)

    def turn(self, observations: Tensor) -> Tensor:
        """Return the turn of the most probable action."""
        every = self.decisions_per_T
        values = observations[:, every - 1 :: every].flatten(1).float()
        for number, (weight, bias) in enumerate(_place_layers(self, values.device)):
            values = (relu(values) if number else values) @ weight.mT + bias
        return self.largest_turn * (values.argmax(-1).double() - 1.0)


@cache
def _place_layers(steering: PolicySteering, device: torch.device) -> list[tuple[Tensor, Tensor]]:
    """Return its layers on a device, float32."""
    return [(w.to(device, torch.float32), b.to(device, torch.float32)) for w, b in steering.layers]


def load_weights(path: str | Path) -> list[tuple[Tensor, Tensor]]:
    """Read a network with ReLU in between, of a policy trained on ``Predation``.

    ``torch.save`` writes it: a list of weight ``[out, in]`` and bias ``[out]`` of each layer, the
    ``nn.Linear`` among ``load_policy("runs/<name>").modules()``.

    Raises:
        ValueError: if the file holds no network with 16 inputs and 3 actions.
    """
    what, remedy = "steering weights", "see fishrl.envs.steering.load_weights"
    layers = load_tensors(path, what=what, remedy=remedy)
    try:
        shapes = [tuple(weight.shape) for weight, _ in layers]
        sizes = [16, *(len(bias) for _, bias in layers)]
        is_valid = sizes[-1] == 3 and shapes == [(m, n) for n, m in pairwise(sizes)]
    except (AttributeError, TypeError, ValueError):
        is_valid = False
    if not is_valid:
        raise ValueError(f"{what} {path}: no layers from 16 inputs to 3 actions in it; {remedy}")
    return [(weight, bias) for weight, bias in layers]
