"""Body outlines and the markers on them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fishrl.physics.kinematics import CARLING, Gait, Modes

_STATIONS = 20001  # quadrature and arc-length stations along the body; set-up cost only


def compute_naca_half_thickness(x: NDArray[np.float64], thickness: float) -> NDArray[np.float64]:
    """Return the half-thickness of a symmetric NACA 4-digit section, closed trailing edge.

    Args:
        x: distance from the nose in body lengths.
        thickness: largest thickness in body lengths (0.12 for NACA0012).

    Source: Jacobs, Ward & Pinkerton 1933, with -0.1036 x^4 for a closed trailing edge.
    """
    poly = 0.2969 * np.sqrt(x) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4
    return np.asarray(5.0 * thickness * poly, dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class Fish:
    """A fish: NACA outline, gait and what moves it.

    Args:
        body_length: L in nodes.
        thickness: largest thickness in body lengths.
        gait: amplitude envelope and wavenumber.
        density_ratio: body density over fluid density; 1 is neutrally buoyant.
        marker_spacing: distance of the markers along the outline, in nodes.
    """

    body_length: float
    thickness: float = 0.12
    gait: Gait = CARLING
    density_ratio: float = 1.0
    marker_spacing: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a body that the markers cannot resolve."""
        if self.body_length < 16:
            raise ValueError(
                f"body_length = {self.body_length} nodes: a fish needs at least 16 nodes"
            )
        if not 0.0 < self.thickness <= 0.4:
            raise ValueError(f"thickness = {self.thickness}: allowed is (0, 0.4] body lengths")
        if self.density_ratio < 1.0:
            raise ValueError(
                f"density_ratio = {self.density_ratio}: allowed is 1 (neutrally buoyant) and above"
            )
        if not 0.5 <= self.marker_spacing <= 2.0:
            raise ValueError(
                f"marker_spacing = {self.marker_spacing}: allowed is 0.5 to 2 nodes, 1 is usual"
            )

    @cached_property
    def _stations(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Axial position, half-thickness and arc length from the nose at many stations, nodes."""
        x = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, _STATIONS)))
        h = self.body_length * np.maximum(compute_naca_half_thickness(x, self.thickness), 0.0)
        axial = self.body_length * x
        arc = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(axial), np.diff(h)))))
        return axial, h, arc

    @cached_property
    def area(self) -> float:
        """Area of the body, nodes^2."""
        axial, h, _ = self._stations
        return float(np.trapezoid(2.0 * h, axial))

    @cached_property
    def num_markers(self) -> int:
        """Number of markers N on the outline; even, so that nose and tail are markers."""
        return 2 * max(8, round(float(self._stations[2][-1]) / self.marker_spacing))

    @cached_property
    def spacing(self) -> float:
        """Distance of the markers along the outline that an equal division gives, nodes."""
        return float(2.0 * self._stations[2][-1] / self.num_markers)

    def make_modes(self, device: torch.device | str = "cpu") -> Modes:
        """Place the markers and integrate the gait's modes over the body, in float64.

        Marker 0 is the nose; markers follow the outline (upper side to the tail, lower side back)
        at equal arc length; their number is even, so one marker is the tail.
        """
        axial, h, arc = self._stations
        half = self.num_markers // 2
        upper = np.interp(np.linspace(0.0, arc[-1], half + 1), arc, axial)
        at = np.concatenate((upper, upper[-2:0:-1]))
        sign = np.concatenate((np.ones(half + 1), -np.ones(half - 1)))
        lateral = sign * np.interp(at, axial, h)

        def integrate(values: NDArray[np.float64]) -> float:
            return float(np.trapezoid(values, axial))

        area = self.area
        centre = integrate(2.0 * h * axial) / area
        arm, x = axial - centre, axial / self.body_length
        envelope = self.body_length * self.gait.evaluate_envelope(x)
        sine, cosine = (envelope * trig(self.gait.wavenumber * x) for trig in (np.sin, np.cos))
        sine_mean, cosine_mean = (integrate(2.0 * h * m) / area for m in (sine, cosine))
        sine, cosine = sine - sine_mean, cosine - cosine_mean
        scalars = (
            integrate(2.0 * h * arm * sine),
            integrate(2.0 * h * arm * cosine),
            integrate(2.0 * h * sine * sine),
            integrate(2.0 * h * sine * cosine),
            integrate(2.0 * h * cosine * cosine),
            area,
            integrate(2.0 * h * arm**2 + 2.0 / 3.0 * h**3),
        )
        fields = (at - centre, lateral, np.interp(at, axial, sine), np.interp(at, axial, cosine))
        return Modes(*(_to_tensor(v, device) for v in (*fields, *scalars)))


def _to_tensor(value: NDArray[np.float64] | float, device: torch.device | str) -> Tensor:
    return torch.as_tensor(np.asarray(value), dtype=torch.float64, device=device)
