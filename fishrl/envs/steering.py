"""Who turns the fish while a policy chooses its tail beat.

Without steering a fish in a wake turns broadside within a few T and is lost. Each interval steering
looks where the fish is and how it heads, remembers the last sights, and orders a turn, which the
body carries out smoothly over the interval. The fish faces upstream at heading pi.
"""

import pickle
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import pi, radians
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import relu

from fishrl.envs.sensors import sense_target, wrap_angle


class Steering(ABC):
    """A helmsman without a state of its own; what it has seen is handed to it.

    Attributes:
        num_stacked: S, how many sights it remembers, the present one included.
        decisions_per_T: how often it must be asked; None if that does not matter.
    """

    num_stacked: int
    decisions_per_T: int | None = None

    @abstractmethod
    def look(self, nose: Tensor, middle: Tensor, heading: Tensor) -> Tensor:
        """Return what it sees ``[B, n]``, float64.

        Args:
            nose: ``[B, 2]`` its place, x downstream, y from the line to hold, body lengths.
            middle: ``[B, 2]`` place of the body's middle, the mean of its outline.
            heading: ``[B]`` radians.
        """

    @abstractmethod
    def turn(self, sights: Tensor) -> Tensor:
        """Return the change of heading ``[B]`` in radians for the coming interval.

        Args:
            sights: ``[B, S, n]``, oldest first; the first one of an episode is repeated.
        """


@dataclass(frozen=True, kw_only=True)
class PIDSteering(Steering):
    """Aim upstream and towards a line, against where the fish is drifting to and long has been.

    It is the body's middle that is held: the nose sways with every beat, and a helmsman who follows
    it, looking about once a beat, sees a drift that is none. The wanted heading is off the upstream
    direction by gain times the lateral offset, integral gain times its mean over all sights, and
    damping times its change, in radians per body length; the turn towards it is bounded. Without
    the mean, a fish in a wake sits beside the line, leaning against a steady pull outwards.

    Args:
        num_stacked: S, sights that the mean is over, one per decision; not less than 2.
        gain: radians per body length of offset.
        integral_gain: radians per body length of the mean offset.
        damping: radians per body length that the offset grew within the last interval.
        max_angle_degrees: most that the wanted heading is off upstream.
        max_turn_degrees: most that one interval turns.
    """

    num_stacked: int = 32
    gain: float = 1.0
    integral_gain: float = 1.0
    damping: float = 0.0
    max_angle_degrees: float = 15.0
    max_turn_degrees: float = 15.0

    def __post_init__(self) -> None:
        """Refuse steering away from the line, and bounds that forbid steering."""
        if self.num_stacked < 2:
            raise ValueError(f"num_stacked = {self.num_stacked}: must be at least 2")
        for name in ("gain", "integral_gain", "damping"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} = {getattr(self, name)}: must not be negative")
        for name in ("max_angle_degrees", "max_turn_degrees"):
            if not 0.0 < getattr(self, name) <= 90.0:
                raise ValueError(f"{name} = {getattr(self, name)}: allowed is above 0, up to 90")

    def look(self, nose: Tensor, middle: Tensor, heading: Tensor) -> Tensor:
        """Return how far the middle is above the line, and the heading."""
        return torch.stack((middle[:, 1], heading), -1)

    def turn(self, sights: Tensor) -> Tensor:
        """Return the bounded turn towards the wanted heading."""
        offsets, heading = sights[..., 0], sights[:, -1, 1]
        offset, before = offsets[:, -1], offsets[:, -2]
        most, step = radians(self.max_angle_degrees), radians(self.max_turn_degrees)
        # a heading above pi points down, so a fish that is too high turns counter-clockwise
        aim = self.gain * offset + self.integral_gain * offsets.mean(1)
        aim = aim + self.damping * (offset - before)
        return wrap_angle(pi + aim.clamp(-most, most) - heading).clamp(-step, step)


@dataclass(frozen=True, kw_only=True)
class PolicySteering(Steering):
    """Let the network that learned to catch food steer, after a point upstream.

    It acts greedily: turn clockwise, keep, turn counter-clockwise. The point lies ahead of the
    fish, as food would, on the line to hold. Where it is asked several times per T, it is shown
    sights a T apart, as when it learned, and each time turns by its share.

    Args:
        path: file that ``save_weights`` wrote; by default that of a fish trained on ``Predation``
            in still water at L = 50, which comes with the package.
        turn_degrees: in a T.
        ahead_bl: how far upstream of the nose the point lies, body lengths.
        decisions_per_T: how often it is asked; it learned with one.
    """

    path: str = str(Path(__file__).with_name("steering.pt"))
    turn_degrees: float = 15.0
    ahead_bl: float = 2.0
    decisions_per_T: int = 4

    def __post_init__(self) -> None:
        """Read the weights, so that a wrong file shows at once."""
        if self.ahead_bl <= 0.0:
            raise ValueError(f"ahead_bl = {self.ahead_bl}: must be positive")
        if self.decisions_per_T < 1:
            raise ValueError(f"decisions_per_T = {self.decisions_per_T}: must be at least 1")
        widths = [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]
        if widths[0] != 16 or widths[-1] != 3:
            raise ValueError(
                f"steering weights {self.path}: layers of widths {widths}, expected 16 numbers in "
                "and 3 actions out, those of a policy trained on Predation"
            )

    @property
    def num_stacked(self) -> int:  # type: ignore[override]
        """Sights of four T."""
        return 4 * self.decisions_per_T

    @cached_property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weight and bias of each layer."""
        return load_weights(self.path)

    def look(self, nose: Tensor, middle: Tensor, heading: Tensor) -> Tensor:
        """Return the point as the head would see food there, see ``sensors.sense_target``."""
        ahead = torch.stack((nose[:, 0] - self.ahead_bl, torch.zeros_like(heading)), -1)
        return sense_target(nose, heading, ahead, body_length=1.0)

    def turn(self, sights: Tensor) -> Tensor:
        """Return the turn of the likeliest action."""
        every = self.decisions_per_T
        values = sights[:, every - 1 :: every].flatten(1).float()
        for number, (weight, bias) in enumerate(self.layers):
            values = (relu(values) if number else values) @ weight.to(values).mT + bias.to(values)
        return radians(self.turn_degrees) / every * (values.argmax(-1).double() - 1.0)


def save_weights(layers: list[tuple[Tensor, Tensor]], path: str | Path) -> None:
    """Write the weights ``[out, in]`` and biases ``[out]`` of a network with ReLU in between."""
    torch.save([(weight.detach().cpu(), bias.detach().cpu()) for weight, bias in layers], path)


def load_weights(path: str | Path) -> list[tuple[Tensor, Tensor]]:
    """Read what ``save_weights`` wrote.

    Raises:
        ValueError: if there is no such file, or something else in it.
    """
    file = Path(path).expanduser()
    if not file.is_file():
        raise ValueError(
            f"steering weights {file}: there is no such file; write one with save_weights, or take "
            "PIDSteering"
        )
    try:
        layers = torch.load(file, map_location="cpu", weights_only=True)
        sizes = [(tuple(weight.shape), tuple(bias.shape)) for weight, bias in layers]
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise ValueError(
            f"steering weights {file}: cannot be read; write it anew with save_weights"
        ) from error
    except (TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"steering weights {file}: no list of layers in it") from error
    follows = all(a[0][0] == b[0][1] for a, b in pairwise(sizes))
    if not sizes or not follows or any(w[:1] != b or len(w) != 2 for w, b in sizes):
        raise ValueError(f"steering weights {file}: layers of shapes {sizes} do not fit together")
    return [(weight, bias) for weight, bias in layers]
