"""Neuromasts: places, features, noise, silence and delay."""

import math
from math import pi

import pytest
import torch
from torch import Tensor

from fishrl.envs.lateral_line import LOCAL, PAPER, LateralLine
from fishrl.physics import Fish, FlowConfig, InPlaceSolver
from fishrl.physics.flow import make_uniform
from tests.physics.flows import start_solver

LENGTH, PERIOD = 20, 200
UNIT = LENGTH / PERIOD
KEYS = torch.tensor([5, 6])


def make_solver(
    ux: float = 0.0, uy: float = 0.0, rho: float = 0.0, heading: float = pi
) -> InPlaceSolver:
    """Return two fish amid a uniform flow."""
    config = FlowConfig(width=60, height=50, tau=0.6, bodies=(Fish(body_length=LENGTH),))
    place = torch.tensor([[30.0, 25.0]]).expand(2, 2)
    solver = start_solver(config, place, torch.full((2,), heading), frequency=1.0 / PERIOD)
    full = torch.ones(2, 50, 60)
    solver.set_populations_(make_uniform(rho * full, ux * full, uy * full))
    return solver


def sense(line: LateralLine, solver: InPlaceSolver, keys: Tensor = KEYS) -> Tensor:
    return line.sense(solver, keys, body_length=LENGTH, period=PERIOD)[0]


def feel(line: LateralLine, solver: InPlaceSolver) -> dict[str, Tensor]:
    """Return the signals ``[B, P]`` by feature."""
    signal = sense(line, solver).double()
    return dict(zip(line.features, signal.unbind(-1), strict=True))


def assert_near(got: Tensor, wanted: Tensor | float, atol: float = 1e-4) -> None:
    wanted = torch.as_tensor(wanted).to(got).expand_as(got)
    torch.testing.assert_close(got, wanted, rtol=0, atol=atol)


@pytest.mark.parametrize("heading", [pi, 0.7])
def test_neuromasts_lie_in_pairs_next_to_the_skin(heading: float) -> None:
    solver = make_solver(heading=heading)
    points, _, normal = LateralLine(num_neuromasts=5, first_bl=0.25, last_bl=0.75).place(solver)
    markers = solver.markers()
    gap = (points[:, :, None] - markers[:, None]).norm(dim=-1).amin(-1)
    assert_near(gap, 2.0, atol=0.05)
    forward = torch.tensor([math.cos(heading), math.sin(heading)])
    left = torch.stack((-forward[1], forward[0]))
    away = (points - markers[:, :1])[0].float()
    ahead, aside = away @ forward / LENGTH, away @ left
    assert_near(ahead, torch.tensor([0.1, -0.25, -0.25, -0.75, -0.75]), atol=0.06)
    assert aside.sign()[1:].tolist() == [-1.0, 1.0, -1.0, 1.0]  # right, left
    assert round(float(aside[0]), 6) == 0.0
    torch.testing.assert_close(normal.square().sum(-1), torch.ones(2, 5).double())


def test_paper_features_are_those_in_the_frame_at_rest() -> None:
    line, solver = LateralLine(features=PAPER), make_solver(ux=0.03, uy=-0.04, rho=0.006)
    points, signals = line.place(solver)[0] / LENGTH, feel(line, solver)
    expected = {"t": 0.0, "u_x": 0.3, "u_y": -0.4, "speed": 0.5, "p": 0.2}
    for name, value in {**expected, "x": points[..., 0], "y": points[..., 1]}.items():
        assert_near(signals[name], value)
    solver.body.age.fill_(100.0)
    assert (feel(line, solver)["t"] == 0.5).all()


def test_local_velocity_is_relative_to_the_skin() -> None:
    """It drifts at 0.01 along x, the water at 0.03: for a fish that faces -x, 0.2 L/T come from
    behind. Turning adds a difference between nose and tail."""
    line = LateralLine(num_neuromasts=4, features=("ahead", "left", "slip"))
    solver = make_solver(ux=0.03)
    solver.body.velocity.copy_(torch.tensor([[0.01, 0.0], [0.01, 0.0]]))
    solver.body.frequency.zero_()
    for name, value in (("ahead", -0.2), ("left", 0.0), ("slip", 0.2)):
        assert_near(feel(line, solver)[name], value)
    solver.body.angular_velocity.fill_(0.001)  # counter-clockwise: the nose goes left
    left = feel(line, solver)["left"][0]
    assert left[0] < 0.0 < left[-1]


def test_local_features_do_not_depend_on_the_heading() -> None:
    line, c = LateralLine(features=(*LOCAL, "shear")), 0.03
    one = feel(line, make_solver(ux=-c))
    other = feel(line, make_solver(uy=c, heading=0.5 * pi))
    for name in line.features:
        assert_near(one[name], other[name])


def test_shear_is_tangential_velocity_over_distance() -> None:
    line = LateralLine(num_neuromasts=4, features=("pressure", "shear"), distance=2.5)
    solver = make_solver(ux=0.03, rho=0.01)
    solver.body.frequency.zero_()
    signals, flat = feel(line, solver), 0.3 * LENGTH / 2.5
    assert signals["pressure"].abs().max() < 1e-5
    assert ((signals["shear"].abs() / flat - 0.955).abs() < 0.055).all()
    assert signals["shear"][0, 0] * signals["shear"][0, 1] < 0.0  # clockwise round both sides


def test_pressure_is_the_deviation_from_the_mean_over_neuromasts() -> None:
    line, solver = LateralLine(num_neuromasts=4, features=("pressure",)), make_solver()
    x, none = torch.arange(60.0).expand(2, 50, 60), torch.zeros(2, 50, 60)
    solver.set_populations_(make_uniform(1e-4 * (x - 30.0), none, none))
    points, _, _ = line.place(solver)
    pressure = 1e-4 * (points[..., 0] - 30.0) / (3.0 * UNIT**2)  # c_s^2 (rho - 1), in rho (L / T)^2
    expected = pressure - pressure.mean(-1, keepdim=True)
    assert expected.abs().max() > 0.01
    assert_near(feel(line, solver)["pressure"], expected)


def test_noise_depends_on_key_and_time_alone() -> None:
    solver, line = make_solver(), LateralLine(features=("u_x", "u_y"), noise=0.1)
    signals = []
    for age in range(200):
        solver.body.age.fill_(age)
        signals.append(sense(line, solver))
    noise = torch.stack(signals)
    assert noise.mean().abs() < 0.01 and noise.std().item() == pytest.approx(0.1, rel=0.05)
    correlation = torch.corrcoef(noise.flatten(1).T)  # of neuromasts and features, 200 samples
    assert (correlation - torch.eye(len(correlation))).abs().max() < 5 / 200**0.5
    assert torch.equal(sense(line, solver, KEYS.flip(0)), noise[-1].flip(0))
    assert not torch.equal(noise[0], noise[1])


def test_silent_neuromasts_stay_silent_for_an_episode() -> None:
    solver = make_solver(ux=0.03, uy=0.01)
    line = LateralLine(num_neuromasts=40, features=("u_x", "speed"), silence=0.4)
    is_silent = (sense(line, solver) == 0.0).all(-1)
    solver.body.age.fill_(7.0)
    assert torch.equal(is_silent, (sense(line, solver) == 0.0).all(-1))
    assert not torch.equal(is_silent[0], is_silent[1])
    assert 0.2 < is_silent.float().mean() < 0.6


def test_delay_shifts_the_series_by_samples() -> None:
    before, now = torch.arange(4).view(1, 4, 1), torch.arange(4, 8).view(1, 4, 1)
    late = [LateralLine(num_samples=4, delay=d).delay_series(before, now) for d in (0, 1, 4)]
    assert [each.flatten().tolist() for each in late] == [[4, 5, 6, 7], [3, 4, 5, 6], [0, 1, 2, 3]]
