"""Body outlines and the markers on them.

Every outline is drawn in its own frame, in nodes: the axis runs from nose to tail, so a body whose
heading is pi faces -x and its axis points downstream of a flow along +x.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fishrl.physics.bodies.gait import (
    CARLING,
    Beat,
    Deformation,
    Gait,
    Shape,
    compute_amplitudes,
    deform,
    shear,
)
from fishrl.physics.bodies.midline import MidlineShape, bend_midline
from fishrl.physics.bodies.motion import Commanded, Fixed, Motion
from fishrl.physics.bodies.sections import Section

_STATIONS = 20001  # quadrature and arc-length stations along the body; set-up cost only

_Points = NDArray[np.float64]
AnyShape = Shape | MidlineShape
_COARSE = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True, kw_only=True)
class Outline(ABC):
    """A body in the flow.

    Args:
        density_ratio: body density over fluid density; 1 is neutrally buoyant.
        marker_spacing: wanted distance of the markers along the outline, in nodes.
        inset: how far the markers lie inside the outline, nodes. The force of a marker is spread
            over some nodes around it, so the flow feels a body larger than its markers' outline by
            0.45 nodes (three-point kernel; measured on a cylinder, see the validation page; the
            idea is Breugem's, 2012). Area, mass and gait stay those of the outline itself.
        num_markers: N, instead of what the spacing gives; bodies of different size in one batch
            need the same number.
        motion: what moves the body.
    """

    density_ratio: float = 1.0
    marker_spacing: float = 1.0
    inset: float = 0.45
    num_markers: int = 0
    motion: Motion = field(default_factory=Fixed)

    def __post_init__(self) -> None:
        """Refuse a body that the markers cannot resolve, and choose their number."""
        if self.density_ratio < 1.0:
            raise ValueError(
                f"density_ratio = {self.density_ratio}: allowed is 1 (neutrally buoyant) and above"
            )
        if not 0.5 <= self.marker_spacing <= 2.0:
            raise ValueError(
                f"marker_spacing = {self.marker_spacing}: allowed is 0.5 to 2 nodes, 1 is usual"
            )
        if not 0.0 <= self.inset <= 1.0:
            raise ValueError(f"inset = {self.inset}: allowed is 0 to 1 node")
        perimeter = float(sum(self._lengths))
        if self.num_markers == 0:
            counts = [max(8, round(s / self.marker_spacing)) for s in self._lengths]
            object.__setattr__(self, "num_markers", sum(counts))
        spacing = perimeter / self.num_markers
        if not 0.4 <= spacing <= 2.1:
            raise ValueError(
                f"{type(self).__name__} with num_markers = {self.num_markers}: they would lie "
                f"{spacing:.2f} nodes apart, allowed is 0.5 to 2; a larger or smaller number of "
                "markers, or another size"
            )

    def get_structure(self) -> tuple[object, ...]:
        """Return what this body has in common with its like in other flows of a batch."""
        return type(self), self.num_markers, self.motion

    @abstractmethod
    def draw(self) -> list[_Points]:
        """Return the closed outline as smooth pieces ``[n, 2]`` from corner to corner, in nodes."""

    @cached_property
    def _pieces(self) -> list[_Points]:
        return self.draw()

    @cached_property
    def _lengths(self) -> list[float]:
        return [float(_measure_arc(piece)[-1]) for piece in self._pieces]

    @cached_property
    def _moments(self) -> tuple[float, _Points, float]:
        """Area, centre of area and polar moment of area about it."""
        points = np.concatenate([piece[:-1] for piece in self._pieces])
        x, y = points.T
        x1, y1 = np.roll(x, -1), np.roll(y, -1)
        cross = x * y1 - y * x1
        area = cross.sum() / 2.0
        centre = np.array([((x + x1) * cross).sum(), ((y + y1) * cross).sum()]) / (6.0 * area)
        square = ((x * x + x * x1 + x1 * x1 + y * y + y * y1 + y1 * y1) * cross).sum() / 12.0
        return abs(area), centre, abs(square) - abs(area) * float(centre @ centre)

    @property
    def area(self) -> float:
        """Area of the body, nodes^2."""
        return self._moments[0]

    @property
    def centre(self) -> float:
        """Distance of the centre of area from the nose, nodes."""
        return float(self._moments[1][0] - self._pieces[0][0, 0])

    @property
    def size(self) -> float:
        """Largest extent along an axis, nodes."""
        points = np.concatenate(self._pieces)
        return float(np.ptp(points, axis=0).max())

    def _place_markers(self) -> tuple[_Points, _Points]:
        """Return markers ``[N, 2]`` and the length of outline that each stands for, ``[N]``.

        Every corner of the outline has a marker; all are then moved inwards by ``inset``.
        """
        lengths = np.array(self._lengths)
        share = lengths / lengths.sum() * self.num_markers
        counts = np.floor(share + 1e-9).astype(int)
        for i in np.argsort(counts - share, kind="stable")[: self.num_markers - counts.sum()]:
            counts[i] += 1
        pieces = []
        for piece, length, count in zip(self._pieces, lengths, counts, strict=True):
            at = np.linspace(0.0, length, count, endpoint=False)
            arc = _measure_arc(piece)
            pieces.append(np.stack([np.interp(at, arc, c) for c in piece.T], -1))
        places = np.concatenate(pieces)
        if self.inset:
            tangent = np.roll(places, -1, 0) - np.roll(places, 1, 0)
            inward = np.stack([tangent[:, 1], -tangent[:, 0]], -1)  # outlines run clockwise
            moved = places + self.inset * inward / np.hypot(*tangent.T)[:, None]
            # where a body is thinner than twice the inset, its two sides meet but never cross
            is_across = moved[:, 1] * places[:, 1] < 0.0
            places = np.where(is_across[:, None], moved * np.array([1.0, 0.0]), moved)
        step = np.hypot(*(np.roll(places, -1, 0) - places).T)
        return places, 0.5 * (step + np.roll(step, 1))

    def make_shape(self, device: torch.device | str = "cpu") -> AnyShape:
        """Place the markers, in float64; marker 0 is the nose. See ``Shape``."""
        places, spacing = self._place_markers()
        area, centre, inertia = self._moments
        axial, lateral = (places - centre).T
        none = np.zeros((1, len(axial)))
        values = axial, lateral, spacing, none, none[:, 0], none[:, :1], area, inertia
        return Shape(*_to_tensors(device, *values, self.density_ratio))

    def deform(self, shape: AnyShape, beat: Beat) -> Deformation:
        """Return the outline at one instant."""
        assert isinstance(shape, Shape)
        return deform(shape, beat)

    def draw_at(self, shape: AnyShape, beat: Beat) -> tuple[Tensor, Tensor]:
        """Return the same outline, along and across the axis ``[B, N]``, without its motion."""
        if isinstance(shape, Shape):
            return shape.axial, shear(shape, compute_amplitudes(beat)[0])
        deformation = self.deform(shape, beat)
        return deformation.axial, deformation.lateral


@dataclass(frozen=True, kw_only=True)
class Ellipse(Outline):
    """An ellipse.

    Args:
        length: axis along the body axis, nodes.
        width: axis across it, nodes.
    """

    length: float
    width: float

    def draw(self) -> list[_Points]:
        """Return one piece, from the nose round."""
        _check_size("length", self.length)
        _check_size("width", self.width)
        angle = np.pi - np.linspace(0.0, 2.0 * np.pi, _STATIONS)
        x, y = 0.5 * self.length * np.cos(angle), 0.5 * self.width * np.sin(angle)
        return [np.stack([x, y], -1)]


@dataclass(frozen=True, kw_only=True)
class Cylinder(Outline):
    """A circular cylinder.

    Args:
        diameter: D in nodes.
    """

    diameter: float

    def draw(self) -> list[_Points]:
        """Return one piece, from the nose round."""
        return Ellipse(length=self.diameter, width=self.diameter).draw()


@dataclass(frozen=True, kw_only=True)
class DCylinder(Outline):
    """Half a disc; its nose is the middle of the round side.

    With heading pi the round side faces -x and the flat side +x, downstream of a flow along +x
    (Liao et al. 2003; our default); with heading 0 the flat side meets the flow.

    Args:
        diameter: D in nodes, the length of the flat side.
    """

    diameter: float

    def draw(self) -> list[_Points]:
        """Return the two quarters of the round side and the flat side between them."""
        _check_size("diameter", self.diameter)
        angle = np.pi - np.linspace(0.0, 0.5 * np.pi, _STATIONS)
        radius = 0.5 * self.diameter
        upper = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
        lower = upper[::-1] * np.array([1.0, -1.0])
        return [upper, np.stack([upper[-1], lower[0]]), lower]


@dataclass(frozen=True, kw_only=True)
class Foil(Outline):
    """A rigid NACA 4-digit foil without camber.

    Args:
        chord: in nodes.
        thickness: largest thickness in chords (0.12 for NACA0012).
    """

    chord: float
    thickness: float = 0.12

    def draw(self) -> list[_Points]:
        """Return the upper side to the trailing edge and the lower side back."""
        _check_size("chord", self.chord)
        return _draw_section(Section.NACA, self.chord, self.thickness)


@dataclass(frozen=True, kw_only=True)
class Fish(Outline):
    """A fish: outline, gait and what moves it.

    Args:
        body_length: L in nodes.
        section: family of its half-thickness.
        thickness: largest thickness in body lengths.
        gait: amplitude envelope and wavenumber.
        keeps_length: whether the midline keeps its length (``midline.bend_midline``) instead of the
            paper's vertical shear (``kinematics.deform``).
        inset: see ``Outline``; 0 unless said otherwise, since a fish's tail is thinner than the
            kernel is wide. 0.45 makes a coarse fish faster, nearer to what a fine one swims (the
            swimmer in the validation page).
        motion: commanded heading unless said otherwise.
    """

    body_length: float
    section: Section = Section.NACA
    thickness: float = 0.12
    gait: Gait = CARLING
    keeps_length: bool = False
    inset: float = 0.0
    motion: Motion = field(default_factory=Commanded)

    def __post_init__(self) -> None:
        """Refuse a fish that the nodes cannot resolve."""
        if self.body_length < 16:
            raise ValueError(
                f"body_length = {self.body_length} nodes: a fish needs at least 16 nodes"
            )
        slope = float(np.hypot(*self.gait.evaluate_modes(_COARSE, 1)[:2]).max())
        if self.keeps_length and slope > 0.95:
            raise ValueError(
                f"keeps_length: the gait's midline rises by {slope:.2f} per unit of arc, allowed "
                "is 0.95: lower the amplitude or the wavenumber"
            )
        super().__post_init__()

    def draw(self) -> list[_Points]:
        """Return the straight outline: the upper side to the tail and the lower side back."""
        return _draw_section(self.section, self.body_length, self.thickness)

    def get_structure(self) -> tuple[object, ...]:
        """Return what this fish has in common with its like in other flows of a batch."""
        return *super().get_structure(), self.keeps_length

    @property
    def spacing(self) -> float:
        """Distance of the markers along the outline, nodes."""
        return float(sum(self._lengths)) / self.num_markers

    def make_shape(self, device: torch.device | str = "cpu") -> AnyShape:
        """Place the markers and integrate the gait's modes over the body, in float64.

        Marker 0 is the nose, marker N / 2 the tail.
        """
        if self.keeps_length:
            return self._make_midline(device)
        places, spacing = self._place_markers()
        axial, h = self._pieces[0].T

        def integrate(values: _Points) -> float:
            return float(np.trapezoid(values, axial))

        area, centre = self.area, self.centre
        x = axial / self.body_length
        modes = self.body_length * self.gait.evaluate_modes(x)
        waves = [wave - integrate(2.0 * h * wave) / area for wave in modes]
        values = (
            places[:, 0] - centre,
            places[:, 1],
            spacing,
            np.stack([np.interp(places[:, 0], axial, wave) for wave in waves]),
            np.array([integrate(2.0 * h * (axial - centre) * wave) for wave in waves]),
            np.array([[integrate(2.0 * h * a * b) for b in waves] for a in waves]),
            area,
            integrate(2.0 * h * (axial - centre) ** 2 + 2.0 / 3.0 * h**3),
            self.density_ratio,
        )
        return Shape(*_to_tensors(device, *values))

    def _make_midline(self, device: torch.device | str) -> MidlineShape:
        """Put points on the midline, four between neighbouring markers of one side."""
        places, spacing = self._place_markers()
        half = self.num_markers // 2
        upper = np.clip(places[: half + 1, 0], 0.0, self.body_length)
        knots = np.concatenate(([0.0], upper, [self.body_length]))
        fine = np.interp(np.arange(4 * (half + 2) + 1) / 4.0, np.arange(half + 3), knots)
        own = 4 * (1 + np.arange(half + 1))
        step = np.diff(fine, prepend=0.0)
        half_thickness = self.section.compute_half_thickness(
            np.minimum(fine / self.body_length, 1.0), self.thickness
        )
        scales = self.body_length ** (1.0 - np.arange(3.0))
        modes = [
            s * self.gait.evaluate_modes(fine / self.body_length, k) for k, s in enumerate(scales)
        ]
        values = (
            spacing,
            places[:, 1],
            np.concatenate((own, own[-2:0:-1])),
            step,
            0.5 * (step + np.append(step[1:], 0.0)),
            self.body_length * half_thickness,
            np.stack(modes, 1),
            self.area,
            self.density_ratio,
        )
        return MidlineShape(*_to_tensors(device, *values))

    def deform(self, shape: AnyShape, beat: Beat) -> Deformation:
        """Return the outline at one instant."""
        return bend_midline(shape, beat) if isinstance(shape, MidlineShape) else deform(shape, beat)


def _draw_section(section: Section, length: float, thickness: float) -> list[_Points]:
    """Return the upper side to the tail and the lower side back."""
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, _STATIONS)))
    upper = length * np.stack([x, section.compute_half_thickness(x, thickness)], -1)
    return [upper, upper[::-1] * np.array([1.0, -1.0])]


def _measure_arc(piece: _Points) -> _Points:
    """Return the arc length from the first point to each, ``[n]``."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(piece, axis=0).T))))


def _check_size(name: str, value: float) -> None:
    if value < 8.0:
        raise ValueError(f"{name} = {value} nodes: a body needs at least 8 nodes along each axis")


def _to_tensors(device: torch.device | str, *values: NDArray[Any] | float) -> list[Tensor]:
    return [
        torch.as_tensor(np.asarray(v), dtype=torch.float64, device=device)[None] for v in values
    ]
