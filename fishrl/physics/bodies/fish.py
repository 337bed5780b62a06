"""A fish: outline, gait and what moves it."""

from typing import Annotated, ClassVar

import numpy as np
import torch
from pydantic import Field

from fishrl.physics.bodies.gait import CARLING, Gait
from fishrl.physics.bodies.midline import Curve, MidlineParams, Slope
from fishrl.physics.bodies.motion import Commanded, Motion
from fishrl.physics.bodies.outline import BodyConfig, BodyParams, Points, draw_section, to_tensors
from fishrl.physics.bodies.sections import Section
from fishrl.physics.bodies.shear import ShearParams
from fishrl.physics.bodies.strokes import Strokes

_COARSE = np.linspace(0.0, 1.0, 201)


class Fish(BodyConfig):
    """A fish: outline, gait and what moves it.

    Args:
        body_length: L in nodes.
        section: family of half-thickness profiles.
        thickness: largest thickness in body lengths.
        gait: amplitude envelope and wavenumber.
        keeps_length: whether the midline keeps its length (``midline.py``) instead of the paper's
            vertical shear (``shear.py``).
        strokes: curvatures that the midline follows instead of the gait; it then keeps its length.
        inset: see ``BodyConfig``. With an immersed boundary on a coarse grid, 0.45 makes the fish
            faster, closer to its speed on a fine one (the swimmer on the validation page).
        motion: degrees of freedom; by default the heading follows the command.
    """

    body_length: Annotated[float, Field(ge=16)]
    section: Section = Section.NACA
    thickness: Annotated[float, Field(gt=0, le=0.4)] = 0.12
    gait: Gait = CARLING
    keeps_length: bool = False
    strokes: Strokes | None = None
    motion: Motion = Commanded()

    deforms: ClassVar[bool] = True
    is_slender: ClassVar[bool] = True

    def __post_init__(self) -> None:
        slope = float(np.hypot(*self.gait.evaluate_modes(_COARSE, 1)[:2]).max())
        if self.keeps_length and slope > 0.95:
            raise ValueError(
                f"keeps_length: the gait's midline rises by {slope:.2f} per unit of arc, allowed "
                "is 0.95: lower the amplitude or the wavenumber"
            )
        if self.strokes is not None:
            half = self.section.compute_half_thickness(_COARSE, self.thickness)
            bend = float((self.strokes.bound_curvature(_COARSE) * half).max())
            if bend >= 1.0:
                raise ValueError(
                    f"strokes: curvature times half-thickness reaches {bend:.2f}, allowed is below "
                    "1, where sections would overlap: lower the curvatures or the thickness"
                )
        super().__post_init__()
        if self.num_markers % 2:
            raise ValueError(f"num_markers = {self.num_markers}: must be even (half on each side)")

    def compute_wall_speed(self, frequency: float) -> float:
        """Add the speed of the tail, except for strokes."""
        tail = 0.0 if self.strokes else self.gait.tail_speed * self.size * abs(frequency)
        return super().compute_wall_speed(frequency) + tail

    @property
    def can_bend(self) -> bool:
        """Whether the midline is sheared, so that a command can add to it."""
        return not self.keeps_length and self.strokes is None

    def draw(self) -> list[Points]:
        """Return the straight outline: the upper side to the tail and the lower side back."""
        return draw_section(self.section, self.body_length, self.thickness)

    def get_structure(self) -> tuple[object, ...]:
        """Return what this fish must share with its counterparts in other flows of a batch."""
        num_strokes = 0 if self.strokes is None else len(self.strokes.sequence)
        return *super().get_structure(), self.keeps_length, num_strokes

    def make_params(self, device: torch.device | str = "cpu") -> BodyParams:
        """Place the markers and integrate the gait's modes over the body, in float64.

        Marker 0 is the nose, marker N / 2 the tail.
        """
        if self.keeps_length or self.strokes is not None:
            return self._make_midline(device)
        places, spacing = self._place_markers()
        axial, h = self._pieces[0].T

        def integrate(values: Points) -> float:
            return float(np.trapezoid(values, axial))

        area, centre = self.area, self.centre
        x = axial / self.body_length
        modes = self.body_length * self.gait.evaluate_modes(x)
        waves = [wave - integrate(2.0 * h * wave) / area for wave in modes]
        return ShearParams(
            **to_tensors(
                device,
                axial=places[:, 0] - centre,
                lateral=places[:, 1],
                spacing=spacing,
                modes=np.stack([np.interp(places[:, 0], axial, wave) for wave in waves]),
                moments=np.array([integrate(2.0 * h * (axial - centre) * wave) for wave in waves]),
                gram=np.array([[integrate(2.0 * h * a * b) for b in waves] for a in waves]),
                area=area,
                inertia=integrate(2.0 * h * (axial - centre) ** 2 + 2.0 / 3.0 * h**3),
                density_ratio=self.density_ratio,
            )
        )

    def _make_midline(self, device: torch.device | str) -> MidlineParams:
        """Put points on the midline, four between neighbouring markers of one side."""
        places, spacing = self._place_markers()
        half = len(places) // 2
        upper = np.clip(places[: half + 1, 0], 0.0, self.body_length)
        knots = np.concatenate(([0.0], upper, [self.body_length]))
        fine = np.interp(np.arange(4 * (half + 2) + 1) / 4.0, np.arange(half + 3), knots)
        own = 4 * (1 + np.arange(half + 1))
        step = np.diff(fine, prepend=0.0)
        half_thickness = self.section.compute_half_thickness(
            np.minimum(fine / self.body_length, 1.0), self.thickness
        )
        return MidlineParams(
            curve=self._make_curve(fine / self.body_length, device),
            **to_tensors(
                device,
                spacing=spacing,
                lateral=places[:, 1],
                station=np.concatenate((own, own[-2:0:-1])),
                step=step,
                weight=0.5 * (step + np.append(step[1:], 0.0)),
                half=self.body_length * half_thickness,
                area=self.area,
                density_ratio=self.density_ratio,
            ),
        )

    def _make_curve(self, x: Points, device: torch.device | str) -> Curve:
        if self.strokes is not None:
            return self.strokes.make_curve(x, self.body_length, device)
        scales = self.body_length ** (1.0 - np.arange(3.0))
        modes = [s * self.gait.evaluate_modes(x, k) for k, s in enumerate(scales)]
        return Slope(**to_tensors(device, modes=np.stack(modes, 1)))
