"""Strokes: a midline that follows its curvature."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from fishrl.physics.bodies.fish import Fish
from fishrl.physics.bodies.motion import Free
from fishrl.physics.bodies.sections import Section
from fishrl.physics.bodies.state import BodyState
from fishrl.physics.bodies.strokes import C_START, Stroke, Strokes
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.flow import make_params
from fishrl.physics.geometry import deform_body, place_markers
from fishrl.physics.skins import ImmersedBoundary
from tests.physics.bodies.test_fish import (
    assert_midline_keeps_length_area_and_centre,
    assert_no_angular_momentum,
    make_fish_body,
    outline,
)
from tests.physics.flows import SCALES

LARVA = ImmersedBoundary().fit(
    Fish(body_length=100, section=Section.LARVA, thickness=0.127, strokes=C_START, motion=Free())
)
TIMES = (0.35, 0.6, 1.2, 2.3)  # T, in and after the strokes; it is bent most at 0.6


def at(time: float) -> BodyState:
    return make_fish_body(beats=time)


def test_a_fish_begins_straight() -> None:
    body, straight = at(0.0), replace(LARVA, strokes=None)
    places = place_markers(body, deform_body(LARVA, LARVA.make_params(), body))
    torch.testing.assert_close(places.position, outline(straight, body), rtol=0, atol=0.01)
    assert float(places.deformation_velocity.abs().max()) == 0.0


def test_curvatures_at_the_control_points_are_those_given() -> None:
    """At the end of the first stroke; the splines' second derivative vanishes at both ends."""
    x = np.array([0.0, 0.2, 0.5, 0.75, 0.95, 1.0])
    first, curve = C_START.sequence[0], C_START.make_curve(x, 10.0, "cpu")
    step = torch.zeros(1, len(x), dtype=torch.float64)
    body = at(0.7)
    curvature = curve.draw(body, body.bend, step).curvature[0]
    wave = np.sin(2.0 * math.pi * (0.7 - first.lag * x[2:5]) + C_START.phase)
    expected = (np.array(first.bend) + np.array(first.wave) * wave) / 10.0
    np.testing.assert_allclose(curvature[2:5], expected, atol=1e-12)
    np.testing.assert_allclose(curvature[[0, 1, 5]], 0.0, atol=1e-12)
    fine = np.concatenate((np.arange(3), 1e4 - 2 + np.arange(3))) / 1e4
    splines = C_START.make_curve(fine, 1.0, "cpu").splines[0].numpy()
    for low in (0, 3):
        second = np.diff(splines[:, low : low + 3], 2) / 1e-8
        assert abs(second).max() < 1.0  # elsewhere up to 300


@pytest.mark.parametrize("time", TIMES)
def test_strokes_keep_length_area_and_centre_without_angular_momentum(time: float) -> None:
    """Within the tolerances of gaits, though it bends by far more than 90 degrees."""
    shape, body = LARVA.make_params(), at(time)
    before, after = (outline(LARVA, at(time + d / SCALES.period)) for d in (-0.5, 0.5))
    assert_midline_keeps_length_area_and_centre(LARVA, body, before, after)
    nose, tail = (outline(LARVA, at(0.6))[0, i] for i in (0, LARVA.num_markers // 2))
    assert float((tail - nose).norm()) < 0.65 * LARVA.body_length
    bent = deform_body(LARVA, shape, body)
    assert_no_angular_momentum(bent)
    shift = 0.01 / SCALES.period
    early, late = (
        float(deform_body(LARVA, shape, at(t)).inertia) for t in (time - shift, time + shift)
    )
    assert (late - early) / 0.02 == pytest.approx(float(bent.inertia_rate), rel=1e-4)


def test_fish_of_one_batch_follow_strokes_of_their_own() -> None:
    small = Stroke(duration=0.4, bend=(1.0, 0.5, 0.2), wave=(0.3, 0.2, 0.1), lag=0.2)
    other = Strokes(sequence=(small, C_START.sequence[1]), phase=0.4)
    fish = [LARVA, replace(LARVA, strokes=other)]
    make = partial(make_swimmer_config, SCALES, length_bl=6, height_bl=6, skin=ImmersedBoundary())
    configs = [make(bodies=(each,)) for each in fish]
    both = make_params(configs).bodies[0]
    body = at(0.9)
    twice = BodyState(*(torch.cat((value, value)) for value in body))
    together = both.deform(twice, twice.bend)
    for row, own in enumerate(fish):
        alone = own.make_params().deform(body, body.bend)
        for one, each in zip(alone, together, strict=True):
            torch.testing.assert_close(each[row], one[0], rtol=1e-12, atol=1e-12)
    single = replace(LARVA, strokes=Strokes(sequence=(small,)))
    configs[1] = make(bodies=(single,))
    with pytest.raises(ValueError, match="flow 1 differs"):
        make_params(configs)
