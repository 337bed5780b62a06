"""Outlines: areas, moments, markers; and what moves bodies."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Fixed, Oscillating
from fishrl.physics.bodies.outline import BodyConfig, Cylinder, DCylinder, Ellipse, Foil
from fishrl.physics.bodies.sections import Section
from fishrl.physics.bodies.shear import ShearParams
from fishrl.physics.geometry import deform_body, place_markers
from fishrl.physics.skins import BounceBack, ImmersedBoundary
from tests.physics.flows import ONE, measure_polygon, place_body


def get_shape(outline: BodyConfig) -> ShearParams:
    shape = ImmersedBoundary().fit(outline).make_params()
    assert isinstance(shape, ShearParams)
    return shape


@pytest.mark.parametrize(
    ("outline", "area", "inertia", "perimeter"),
    [
        (Cylinder(diameter=40, inset=0.0), math.pi * 20**2, math.pi / 2 * 20**4, math.pi * 40),
        # Ramanujan's approximation
        (
            Ellipse(length=40, width=20, inset=0.0), math.pi * 200,
            math.pi * 200 * (20**2 + 10**2) / 4, math.pi * (90 - 3500**0.5),
        ),
        # polar moment about the centre of area: pi r^4 / 4 less A (4 r / 3 pi)^2
        (
            DCylinder(diameter=40, inset=0.0), math.pi * 200,
            math.pi * 20**4 / 4 - math.pi * 200 * (80 / (3 * math.pi)) ** 2, 40 + math.pi * 20,
        ),
        # integrals of the section of a NACA 0012
        (Foil(chord=100, inset=0.0), 0.08171 * 100**2, 0.0045097 * 100**4, 203.95),
        (Fish(body_length=100), 0.08171 * 100**2, 0.0045097 * 100**4, 203.95),
    ],
    ids=["cylinder", "ellipse", "half disc", "foil", "fish"],
)  # fmt: skip
def test_outlines_have_their_exact_sizes_and_a_marker_per_node(
    outline: BodyConfig, area: float, inertia: float, perimeter: float
) -> None:
    shape = get_shape(outline)
    assert outline.area == pytest.approx(area, rel=1e-3)
    assert float(shape.area) == pytest.approx(area, rel=1e-3)
    assert float(shape.inertia) == pytest.approx(inertia, rel=1e-3)
    assert float(shape.spacing.sum()) == pytest.approx(perimeter, rel=1e-3)
    markers = torch.stack((shape.axial, shape.lateral), -1)
    assert measure_polygon(markers[0])[0] == pytest.approx(area, rel=0.01)
    gaps = (markers[0].roll(-1, 0) - markers[0]).norm(dim=-1)
    assert float(shape.spacing.sum()) == pytest.approx(float(gaps.sum()))
    assert float(gaps.min()) > 0.7 and float(gaps.max()) < 1.3


def test_half_disc_has_markers_on_corners_and_round_nose() -> None:
    outline = DCylinder(diameter=40, inset=0.0)
    shape = get_shape(outline)
    centroid = 20 - 80 / (3 * math.pi)  # from the nose
    assert float(shape.axial[0, 0]) == pytest.approx(-centroid, abs=1e-3)
    assert float(shape.lateral.abs().max()) == pytest.approx(20.0, abs=1e-6)
    flat = (shape.axial - shape.axial.max()).abs() < 1e-6
    assert int(flat.sum()) > 35
    body = place_body(100.0, 50.0, math.pi)
    markers = place_markers(body, deform_body(outline, shape, body)).position[0]
    assert float(markers[0, 0]) == pytest.approx(100 - centroid, abs=1e-3)  # nose upstream


def test_an_inset_moves_every_marker_inwards_and_keeps_the_mass() -> None:
    plain, inset = Cylinder(diameter=40, inset=0.0), Cylinder(diameter=40, inset=0.3)
    radius = torch.hypot(get_shape(inset).axial, get_shape(inset).lateral)
    torch.testing.assert_close(radius, torch.full_like(radius, 19.7), rtol=0, atol=1e-3)
    assert inset.area == plain.area
    assert float(get_shape(inset).inertia) == float(get_shape(plain).inertia)
    thin, thick = (get_shape(Fish(body_length=50, **inset)) for inset in ({"inset": 0.5}, {}))
    assert (thin.lateral.abs() <= thick.lateral.abs() + 1e-9).all()
    assert (thin.lateral * thick.lateral > -1e-9).all()  # the two sides never cross


def test_the_eel_has_the_thickness_of_its_source() -> None:
    at = Section.EEL.compute_half_thickness(np.array([0.0, 0.04, 0.95, 1.0]), 0.08)
    assert at.tolist() == pytest.approx([0.0, 0.04, 0.01, 0.0])
    fish = Fish(body_length=100, section=Section.EEL, thickness=0.08)
    assert float(fish.draw()[0][:, 1].max()) == pytest.approx(4.0, abs=1e-3)


@pytest.mark.parametrize(
    ("motion", "start"),
    [
        (Oscillating(sway=(3.0, -2.0), pitch=0.4, pitch_lag=0.5 * math.pi), 0.0),
        (Oscillating(pitch=0.4, pivot=5.0), 0.3),
    ],
)
def test_oscillating_body_follows_sines_about_its_pivot(motion: Oscillating, start: float) -> None:
    """From the origin, after 17 of 50 steps."""
    body = place_body(0.0, 0.0, start, 1 / 50)
    for _ in range(17):
        velocity, turn = motion.prescribe(body)
        body = body._replace(
            position=body.position + velocity,
            heading=body.heading + turn,
            phase=body.phase + 2 * math.pi * body.frequency,
        )
    phase, end, lag = 2 * math.pi * 17 / 50, float(body.heading), motion.pitch_lag
    assert end == pytest.approx(start + 0.4 * (math.sin(phase + lag) - math.sin(lag)))
    turned = math.cos(start) - math.cos(end), math.sin(start) - math.sin(end)
    expected = [
        sway * math.sin(phase) + motion.pivot * rise
        for sway, rise in zip(motion.sway, turned, strict=True)
    ]
    assert body.position[0].tolist() == pytest.approx(expected)


def test_a_kick_is_one_period_of_a_sine() -> None:
    motion = Fixed(kick_speed=0.02, kick_steps=30)
    body = place_body(0.0, 0.0)
    speeds = [float(motion.prescribe(body._replace(age=t * ONE))[0][0, 1]) for t in range(40)]
    assert max(speeds) == pytest.approx(0.02, rel=0.01)
    assert sum(speeds) == pytest.approx(0.0, abs=1e-12)
    assert speeds[30:] == [0.0] * 10


class Square(BodyConfig):
    """A square, drawn clockwise or not."""

    side: float
    is_clockwise: bool

    def draw(self) -> list[np.ndarray]:
        corners = self.side * np.array([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
        corners = corners if self.is_clockwise else corners[::-1]
        return [corners[n : n + 2] for n in range(4)]


def test_outline_that_runs_counter_clockwise_is_refused() -> None:
    """Its drag was negative."""
    assert BounceBack().fit(Square(side=20.0, is_clockwise=True)).area == pytest.approx(400.0)
    with pytest.raises(ValueError, match=r"Square.draw\(\) runs counter-clockwise"):
        BounceBack().fit(Square(side=20.0, is_clockwise=False))


@pytest.mark.parametrize("make", [
    lambda size: Fish(body_length=40, thickness=size / 40),
    lambda size: Foil(chord=10, thickness=size / 10),
    lambda size: Square(side=8 * size, is_clockwise=True),
])  # fmt: skip
def test_body_thinner_or_smaller_than_the_grid_resolves_is_refused(
    make: Callable[[float], BodyConfig],
) -> None:
    make(1.1)
    for size in (0.95, 0.5, 0.01):
        with pytest.raises(ValueError, match=r"x .* nodes: give it at least 8 along one axis and"):
            make(size)
