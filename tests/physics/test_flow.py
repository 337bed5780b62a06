"""Sponges and the speed of the stream."""

import math
from itertools import pairwise

import pytest
import torch

from fishrl.physics import FlowConfig, Sponge
from fishrl.physics.flow import change_stream_speed, compute_stream_speed, make_params


def test_a_sponge_raises_tau_smoothly_towards_its_edge_alone() -> None:
    config = FlowConfig(width=40, height=10, tau=0.52, sponges=(Sponge(length=15, tau=1.0),))
    tau = 1.0 / config.compute_omega(torch.tensor([0.52, 0.6, 1.5]))
    assert tau.shape == (3, 10, 40)
    torch.testing.assert_close(tau[:2, 3, -1], torch.ones(2).double())
    torch.testing.assert_close(tau[2], torch.full((10, 40), 1.5).double())
    torch.testing.assert_close(tau[0, :, :24], torch.full((10, 24), 0.52).double())
    assert (tau[0, 0, 24:].diff() > 0).all()


def test_stream_rises_and_changes_as_half_a_cosine_unless_suddenly() -> None:
    config = FlowConfig(width=8, height=8, tau=0.6, stream_speed=0.1, ramp_steps=100)
    params = make_params([config])
    speeds = [float(compute_stream_speed(params, torch.tensor([float(t)]))) for t in range(150)]
    assert speeds[0] == 0.0 and speeds[50] == pytest.approx(0.05) and speeds[149] == 0.1
    assert max(b - a for a, b in pairwise(speeds)) < 0.1 * math.pi / 200 * 1.01
    zero = torch.zeros(1, dtype=torch.float64)
    still = make_params([FlowConfig(width=8, height=8, tau=0.6, stream_speed=0.15)])
    changing = change_stream_speed(still, zero + 30, zero + 0.1, 100)
    speeds = [float(compute_stream_speed(changing, zero + t)) for t in (30, 55, 80, 130, 999)]
    part = torch.tensor([0.0, 0.5 - 0.5**1.5, 0.5, 1.0, 1.0])
    assert speeds == pytest.approx((0.15 - 0.05 * part).tolist())
    sudden = change_stream_speed(changing, zero + 80, zero + 0.02, None)
    assert compute_stream_speed(sudden, zero + 80).item() == pytest.approx(0.02)
    rising = still._replace(ramp_steps=zero + 100)
    sudden = change_stream_speed(rising, zero + 50, zero + 0.04, None)
    assert compute_stream_speed(sudden, zero + 50).item() == pytest.approx(0.02)
