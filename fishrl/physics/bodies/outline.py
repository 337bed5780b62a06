"""Body outlines and the markers on them.

Every outline is drawn in its own frame, in nodes: the axis runs from nose to tail, so a body whose
heading is pi faces -x and its axis points downstream of a flow along +x.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt
from torch import Tensor

from fishrl.physics.bodies.midline import MidlineParams
from fishrl.physics.bodies.motion import Bending, Fixed, Motion
from fishrl.physics.bodies.sections import Section
from fishrl.physics.bodies.shear import ShearParams
from fishrl.physics.lattice import MAX_IMPOSED_SPEED
from fishrl.settings import Settings

#: Least extents of a body along its longer and its shorter axis, nodes.
LEAST_SIZE, LEAST_WIDTH = 8, 1
_STATIONS = 20001  # quadrature and arc-length stations along the body; set-up cost only

Points = NDArray[np.float64]
BodyParams = ShearParams | MidlineParams


class BodyConfig(Settings, ABC):
    """A body in the flow.

    Args:
        density_ratio: body density over fluid density; 1 is neutrally buoyant. With an immersed
            boundary, a body that the flow moves must not be much lighter.
        marker_spacing: target distance of the markers along the outline, in nodes; None takes the
            one of the flow's skin, and half a node for a body without a flow.
        inset: how far the markers lie inside the outline, nodes; None takes the one of the flow's
            skin. Area, mass and gait follow the outline.
        num_markers: N; 0 derives it from the spacing. Bodies of different size in one batch need
            the same number.
        skin: class of the skin that the markers are for; ``FlowConfig`` sets it.
        motion: what moves the body.

    Attributes:
        deforms: whether the outline changes its shape.
        is_slender: whether it is thinner than an immersed boundary somewhere, so that its markers
            must not lie inside.
    """

    former: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("angle", "heading", "position"),
        "no setting of a body: InPlaceSolver.reset_ places it, heading in radians",
    )

    deforms: ClassVar[bool] = False
    is_slender: ClassVar[bool] = False

    density_ratio: Annotated[float, Field(gt=0)] = 1.0
    marker_spacing: Annotated[float, Field(ge=0.5, le=2)] | None = None
    inset: Annotated[float, Field(ge=0, le=1)] | None = None
    num_markers: NonNegativeInt = 0
    skin: str = ""
    motion: Motion = Fixed()

    def __post_init__(self) -> None:
        if isinstance(self.motion, Bending) and not self.can_bend:
            raise ValueError(
                "motion = Bending(): a command bends only a Fish without keeps_length and strokes, "
                f"not this {type(self).__name__}; take Commanded() or Free()"
            )
        across, along = sorted(self._extents)
        if along < LEAST_SIZE or across < LEAST_WIDTH:
            raise ValueError(
                f"{type(self).__name__} of {self._extents[0]:.3g} x {self._extents[1]:.3g} nodes: "
                f"give it at least {LEAST_SIZE} along one axis and {LEAST_WIDTH} along the other"
            )
        self.check_speed(0.0)
        if self.num_markers == 0 and self.marker_spacing is not None:
            object.__setattr__(self, "num_markers", self._count_markers())

    def compute_wall_speed(self, frequency: float) -> float:
        """Return the largest imposed speed of the surface, nodes per step.

        ``frequency`` is in tail beats or oscillations per step.
        """
        return self.motion.compute_wall_speed(0.5 * self.size, frequency)

    def check_speed(self, frequency: float) -> None:
        """Raise ValueError where ``compute_wall_speed`` is more than the method allows."""
        if (speed := self.compute_wall_speed(frequency)) > MAX_IMPOSED_SPEED:
            raise ValueError(
                f"{type(self).__name__} of {self.size:g} nodes with motion = {self.motion} at "
                f"frequency {frequency:g} per step: its surface would move at {speed:.3g} nodes "
                f"per step, allowed is {MAX_IMPOSED_SPEED}: slow it down"
            )

    @property
    def can_bend(self) -> bool:
        """Whether a command can bend the body, beyond its gait."""
        return False

    def get_structure(self) -> tuple[object, ...]:
        """Return what this body must share with its counterparts in other flows of a batch."""
        return type(self), self.motion

    @abstractmethod
    def draw(self) -> list[Points]:
        """Return the closed outline as smooth pieces ``[n, 2]`` from corner to corner, in nodes."""

    @cached_property
    def _pieces(self) -> list[Points]:
        return self.draw()

    @cached_property
    def _lengths(self) -> list[float]:
        return [float(_measure_arc(piece)[-1]) for piece in self._pieces]

    def _count_markers(self) -> int:
        """Return N, on a body without a flow too."""
        spacing = self.marker_spacing or 0.5
        return self.num_markers or sum(max(8, round(s / spacing)) for s in self._lengths)

    @cached_property
    def _moments(self) -> tuple[float, Points, float]:
        """Area, centre of area and polar moment of area about it."""
        points = np.concatenate([piece[:-1] for piece in self._pieces])
        x, y = points.T
        x1, y1 = np.roll(x, -1), np.roll(y, -1)
        cross = x * y1 - y * x1
        area = cross.sum() / 2.0
        if area > 0.0:
            raise ValueError(
                f"{type(self).__name__}.draw() runs counter-clockwise, y upward: reverse pieces "
                "and their points"
            )
        centre = np.array([((x + x1) * cross).sum(), ((y + y1) * cross).sum()]) / (6.0 * area)
        square = ((x * x + x * x1 + x1 * x1 + y * y + y * y1 + y1 * y1) * cross).sum() / 12.0
        return abs(area), centre, abs(square) - abs(area) * float(centre @ centre)

    @property
    def is_still(self) -> bool:
        """Whether the body never moves or deforms."""
        return self.motion.is_still and not self.deforms

    @property
    def spacing(self) -> float:
        """Mean distance of the markers along the outline, nodes."""
        return float(sum(self._lengths)) / self._count_markers()

    @property
    def area(self) -> float:
        """Area of the body, nodes^2."""
        return self._moments[0]

    @property
    def centre(self) -> float:
        """Distance of the centre of area from the nose, nodes."""
        return float(self._moments[1][0] - self._pieces[0][0, 0])

    @cached_property
    def _extents(self) -> list[float]:
        """Extents (x, y), nodes."""
        extents: list[float] = np.ptp(np.concatenate(self._pieces), axis=0).tolist()
        return extents

    @property
    def size(self) -> float:
        """Largest extent along an axis, nodes."""
        return max(self._extents)

    def _place_markers(self) -> tuple[Points, Points]:
        """Return markers ``[N, 2]`` and the length of outline that each represents, ``[N]``.

        Every corner of the outline has a marker; all are then moved inwards by ``inset``.
        """
        lengths, num_markers = np.array(self._lengths), self._count_markers()
        share = lengths / lengths.sum() * num_markers
        counts = np.floor(share + 1e-9).astype(int)
        for i in np.argsort(counts - share, kind="stable")[: num_markers - counts.sum()]:
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

    def make_params(self, device: torch.device | str = "cpu") -> BodyParams:
        """Place the markers, in float64; marker 0 is the nose. See ``ShearParams``."""
        places, spacing = self._place_markers()
        area, centre, inertia = self._moments
        axial, lateral = (places - centre).T
        zeros = np.zeros((1, len(axial)))
        return ShearParams(
            **to_tensors(
                device,
                axial=axial,
                lateral=lateral,
                spacing=spacing,
                modes=zeros,
                moments=zeros[:, 0],
                gram=zeros[:, :1],
                area=area,
                inertia=inertia,
                density_ratio=self.density_ratio,
            )
        )


class Ellipse(BodyConfig):
    """An ellipse.

    Args:
        length: axis along the body axis, nodes.
        width: axis across it, nodes.
    """

    length: Annotated[float, Field(ge=8)]
    width: Annotated[float, Field(ge=8)]

    def draw(self) -> list[Points]:
        """Return one piece, from the nose round."""
        angle = np.pi - np.linspace(0.0, 2.0 * np.pi, _STATIONS)
        x, y = 0.5 * self.length * np.cos(angle), 0.5 * self.width * np.sin(angle)
        return [np.stack([x, y], -1)]


class Cylinder(BodyConfig):
    """A circular cylinder.

    Args:
        diameter: D in nodes.
    """

    diameter: Annotated[float, Field(ge=8)]

    def draw(self) -> list[Points]:
        """Return one piece, from the nose round."""
        return Ellipse(length=self.diameter, width=self.diameter).draw()


class DCylinder(BodyConfig):
    """Half a disc; its nose is the middle of the round side.

    With heading pi the round side faces -x and the flat side +x, downstream of a flow along +x
    (Liao et al. 2003; our default); with heading 0 the flat side meets the flow.

    Args:
        diameter: D in nodes, the length of the flat side.
    """

    diameter: Annotated[float, Field(ge=8)]

    def draw(self) -> list[Points]:
        """Return the two quarters of the round side and the flat side between them."""
        angle = np.pi - np.linspace(0.0, 0.5 * np.pi, _STATIONS)
        radius = 0.5 * self.diameter
        upper = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
        lower = upper[::-1] * np.array([1.0, -1.0])
        return [upper, np.stack([upper[-1], lower[0]]), lower]


class Foil(BodyConfig):
    """A rigid NACA 4-digit foil without camber.

    Args:
        chord: in nodes.
        thickness: largest thickness in chords (0.12 for NACA0012).
    """

    chord: Annotated[float, Field(ge=8)]
    thickness: Annotated[float, Field(gt=0, le=0.4)] = 0.12

    def draw(self) -> list[Points]:
        """Return the upper side to the trailing edge and the lower side back."""
        return draw_section(Section.NACA, self.chord, self.thickness)


def draw_section(section: Section, length: float, thickness: float) -> list[Points]:
    """Return the upper side from nose to tail and the lower side back."""
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, _STATIONS)))
    upper = length * np.stack([x, section.compute_half_thickness(x, thickness)], -1)
    return [upper, upper[::-1] * np.array([1.0, -1.0])]


def to_tensors(device: torch.device | str, **values: NDArray[Any] | float) -> dict[str, Tensor]:
    """Return values as float64 tensors ``[1, ...]``, by name."""
    return {
        name: torch.as_tensor(np.asarray(value), dtype=torch.float64, device=device)[None]
        for name, value in values.items()
    }


def _measure_arc(piece: Points) -> Points:
    """Return the arc length from the first point to each, ``[n]``."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(piece, axis=0).T))))
