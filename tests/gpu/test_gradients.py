"""Gradients through readable steps on a GPU."""

import pytest
import torch
from torch import Tensor

from fishrl.physics import FlowState, Free, simulate
from fishrl.physics.bodies.state import make_body
from fishrl.physics.flow import make_params, make_rest
from tests.physics.flows import SCALES, make_tank

pytestmark = pytest.mark.gpu


def differentiate(device: str) -> Tensor:
    """Return the derivative of a free fish's work with respect to its tail beat, ``[1]``."""
    config = make_tank(motion=Free())
    start = torch.tensor([[40.0, 30.0]], dtype=torch.float64, device=device)
    frequency = torch.full_like(start[:, 0], 1.0 / SCALES.period).requires_grad_()
    body = make_body(start, torch.full_like(start[:, 0], 3.0), frequency)
    state = FlowState(make_rest(config, 1).to(device), (body,))
    params = make_params([config], device)
    state, _ = simulate(state, config, params, num_steps=4, segment=2)
    (slope,) = torch.autograd.grad(state.bodies[0].work.sum(), frequency)
    return slope


def test_gradients_on_a_gpu_equal_those_on_the_cpu() -> None:
    slope = differentiate("cuda")
    assert slope.device.type == "cuda"
    torch.testing.assert_close(slope.cpu(), differentiate("cpu"), rtol=1e-6, atol=0.0)
