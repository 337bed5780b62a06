"""The lateral line: neuromasts along the body that sample the flow next to the skin."""

from collections.abc import Callable
from functools import cache
from math import sqrt
from typing import Annotated, Any

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt
from torch import Tensor

from fishrl.envs.draws import draw_uniform
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.settings import Settings, suggest

#: The paper's features: time since the start in T, position in body lengths, and velocity, pressure
#: and speed in the frame at rest. Time and position leak the flow label.
PAPER = ("t", "x", "y", "u_x", "u_y", "p", "speed")
#: Local features: velocity relative to the skin, along the heading and to its left, its magnitude,
#: and the deviation of the pressure from its mean over the neuromasts.
LOCAL = ("ahead", "left", "pressure", "slip")
#: Estimate of the shear at the skin: tangential velocity over distance.
SHEAR = "shear"
KNOWN = (*PAPER, *LOCAL, SHEAR)


class LateralLine(Settings):
    """P neuromasts in pairs on both sides of a fish, with one at the nose if P is odd.

    Velocities are in L / T, pressures in rho (L / T)^2, shear in 1 / T. Noise and dropout depend on
    a key of the episode, so they are the same in any batch.

    Args:
        num_neuromasts: P; 5 in the paper.
        features: signals of each neuromast, names from ``KNOWN``.
        num_samples: samples W per control interval.
        first_bl: distance of the first pair from the nose, in body lengths.
        last_bl: distance of the last pair.
        distance: distance from the skin, nodes; below 2 the smeared boundary affects the signal.
        is_averaged: average over the neuromasts, as the paper does; excludes ``pressure``, whose
            mean is 0.
        noise: standard deviation of the noise on velocity (L / T) and pressure, per sample.
        silence: probability that a neuromast outputs 0 for a whole episode; averages exclude it.
        delay: delay of the signals in samples; at most W.
    """

    num_neuromasts: Annotated[int, Field(ge=1, le=10_000)] = 5
    features: tuple[str, ...] = LOCAL
    num_samples: PositiveInt = 2
    first_bl: PositiveFloat = 0.2
    last_bl: float = 0.7
    distance: PositiveFloat = 2.0
    is_averaged: bool = False
    noise: NonNegativeFloat = 0.0
    silence: Annotated[float, Field(ge=0, le=1)] = 0.0
    delay: Annotated[int, Field(ge=0, le=10_000)] = 0

    def __post_init__(self) -> None:
        unknown = [name for name in self.features if name not in KNOWN]
        if unknown or not self.features:
            hint = suggest(unknown[0], KNOWN) if unknown else ""
            raise ValueError(f"features = {self.features}: allowed are {KNOWN}{hint}")
        if "pressure" in self.features and (self.is_averaged or self.num_neuromasts == 1):
            raise ValueError(
                f"features = {self.features}, num_neuromasts = {self.num_neuromasts}, is_averaged "
                f"= {self.is_averaged}: pressure is the deviation from the mean over the "
                "neuromasts, whose mean is always 0; remove pressure, or use p"
            )
        if not self.first_bl <= self.last_bl < 1.0:
            raise ValueError(
                f"first_bl = {self.first_bl}, last_bl = {self.last_bl}: allowed is "
                "0 < first_bl <= last_bl < 1"
            )
        if self.delay > self.num_samples:
            raise ValueError(f"delay = {self.delay}: allowed is 0 to {self.num_samples} samples")

    @property
    def layout(self) -> dict[str, Any]:
        """Description of the signals for a classifier, without noise, dropout and delay."""
        return {
            "num_neuromasts": 1 if self.is_averaged else self.num_neuromasts,
            "num_felt": self.num_neuromasts,
            "features": list(self.features),
            "num_samples": self.num_samples,
            "first_bl": self.first_bl,
            "last_bl": self.last_bl,
            "distance": self.distance,
        }

    def place(self, solver: InPlaceSolver) -> tuple[Tensor, Tensor, Tensor]:
        """Return neuromasts' points, velocity of the skin below them, and normals, ``[B, P, 2]``.

        Points are in nodes, velocities in nodes per step, unit normals point out of the body.
        """
        body, markers = solver.body, solver.surface()
        own, after, before = _index_markers(self, markers.position.shape[1], solver.device)
        tangent = markers.position[:, after] - markers.position[:, before]
        length = (tangent * tangent).sum(-1, keepdim=True).sqrt()
        tx, ty = (tangent / length).unbind(-1)
        normal = torch.stack((-ty, tx), -1)  # outlines run clockwise
        rx, ry = markers.arm[:, own].unbind(-1)
        spin = body.angular_velocity[:, None]
        skin = markers.deformation_velocity[:, own] + torch.stack((-spin * ry, spin * rx), -1)
        skin = skin + body.velocity[:, None]
        return markers.position[:, own] + self.distance * normal, skin, normal

    def choose_markers(self, num_markers: int) -> list[int]:
        """Return the markers below the neuromasts: nose, then right and left of each pair."""
        half, num_pairs = num_markers // 2, self.num_neuromasts // 2
        span = self.last_bl - self.first_bl
        own = [0] * (self.num_neuromasts % 2)
        for k in range(num_pairs):
            at = self.first_bl + (span * k / (num_pairs - 1) if num_pairs > 1 else 0.0)
            marker = min(half - 1, max(1, round(at * half)))
            own += [marker, num_markers - marker]
        return own

    def sense(
        self, solver: InPlaceSolver, key: Tensor, *, body_length: float, period: int
    ) -> tuple[Tensor, Tensor]:
        """Return the current signals ``[B, P, F]`` (P = 1 if averaged) and the water's velocity.

        The velocity (x, y) is that in the frame at rest, mean over the neuromasts, ``[B, 2]`` in L
        / T; both are float32.

        Args:
            solver: the flows; the first body is the fish.
            key: ``[B]`` int64, key of the episode.
            body_length: L in nodes.
            period: T in steps.
        """
        points, skin, normal = self.place(solver)
        density, velocity = solver.sample(points)
        unit, age = body_length / period, solver.body.age
        pressure = ((density - 1.0) / (3.0 * unit * unit)).double()
        ux, uy = (velocity.double() / unit).unbind(-1)
        if self.noise > 0.0:
            error = self.noise * _draw_normal(key, age.long(), 3 * self.num_neuromasts)
            ex, ey, ep = error.chunk(3, -1)
            ux, uy, pressure = ux + ex, uy + ey, pressure + ep
        is_active = torch.ones_like(ux, dtype=torch.bool)
        if self.silence > 0.0:
            chance = draw_uniform(1, key, torch.zeros_like(key), self.num_neuromasts)
            is_active = chance >= self.silence
        num_active = is_active.sum(-1, keepdim=True).clamp_min(1)
        sx, sy = (skin / unit).unbind(-1)
        angle = solver.body.heading + solver.body.internal_angle
        cos, sin = torch.cos(angle)[:, None], torch.sin(angle)[:, None]
        past_x, past_y = ux - sx, uy - sy
        nx, ny = normal.unbind(-1)
        read: dict[str, Callable[[], Tensor]] = {
            "t": lambda: (age / period)[:, None].expand_as(ux),
            "x": lambda: points[..., 0] / body_length,
            "y": lambda: points[..., 1] / body_length,
            "u_x": lambda: ux,
            "u_y": lambda: uy,
            "p": lambda: pressure,
            "speed": lambda: (ux * ux + uy * uy).sqrt(),
            "ahead": lambda: cos * past_x + sin * past_y,
            "left": lambda: cos * past_y - sin * past_x,
            "pressure": lambda: (
                pressure - (pressure * is_active).sum(-1, keepdim=True) / num_active
            ),
            "slip": lambda: (past_x * past_x + past_y * past_y).sqrt(),
            "shear": lambda: (ny * past_x - nx * past_y) * (body_length / self.distance),
        }
        signal = torch.stack([read[name]() for name in self.features], -1)
        signal = signal.masked_fill(~is_active[..., None], 0.0)
        if self.is_averaged:
            signal = signal.sum(1, keepdim=True) / num_active[..., None]
        mean = [(value * is_active).sum(-1) / num_active.squeeze(-1) for value in (ux, uy)]
        return signal.float(), torch.stack(mean, -1).float()

    def delay_series(self, before: Tensor, now: Tensor) -> Tensor:
        """Return the delayed series ``[B, W, ...]`` from the series of the last two intervals."""
        if self.delay == 0:
            return now
        both = torch.cat((before, now), 1)
        return both[:, self.num_samples - self.delay : 2 * self.num_samples - self.delay]


@cache
def _index_markers(line: LateralLine, num: int, device: torch.device) -> tuple[Tensor, ...]:
    """Return the markers below the neuromasts, and those after and before each, of ``num``."""
    own = torch.tensor(line.choose_markers(num), device=device)
    return own, (own + 1) % num, (own - 1) % num


def _draw_normal(key: Tensor, age: Tensor, num: int) -> Tensor:
    """Draw ``[B, num]`` of mean 0 and standard deviation 1, as sums of four uniform numbers."""
    a, b, c, d = draw_uniform(0, key, age, 4 * num).chunk(4, -1)
    return (a + b + c + d - 2.0) * sqrt(3.0)
