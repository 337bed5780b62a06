"""Gradients through many steps, against central differences in float64."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from fishrl.physics import Coupling, Fish, FlowState, Scales
from fishrl.physics.bodies.motion import Bending
from fishrl.physics.bodies.state import make_body
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.flow import make_params, make_rest
from fishrl.physics.rollout import estimate_memory, simulate

SCALES = Scales.from_budget(body_length=16, reynolds=300.0, max_wall_speed=0.15)
ONE = torch.ones(1, dtype=torch.float64)
PERIOD = 4 * round(SCALES.period / 4)


def swim(values: Tensor, coupling: Coupling, num_steps: int, **settings: Any) -> Tensor:
    """Return place and work of a free fish; values: tau, frequency, amplitude, bend, x, heading."""
    tau, frequency, amplitude, bend, x, heading = values.unbind()
    fish = Fish(body_length=16, motion=Bending(), **coupling.body_settings)
    config = make_swimmer_config(
        SCALES, length_bl=4, height_bl=3, bodies=(fish,), coupling=coupling
    )
    params = make_params([config])._replace(tau=tau[None])
    place = torch.stack((x, 24.3 * torch.ones_like(x)))[None]
    body = make_body(place, heading[None], frequency[None])
    body = body._replace(amplitude=amplitude[None], amplitude_goal=amplitude[None], beats=2 * ONE)

    def turn(number: int, state: FlowState) -> FlowState:
        (body,) = state.bodies
        command = {"turn": bend[None] * (-1.0) ** number, "turn_clock": 0 * ONE}
        body = body._replace(**command, turn_steps=4 * PERIOD * ONE)
        return state._replace(bodies=(body,))

    state = FlowState(make_rest(config, 1), (body,))
    _, path = simulate(
        state, config, params, num_steps=num_steps, interval=num_steps // 4, control=turn,
        record=lambda state: torch.cat((state.bodies[0].position[0], state.bodies[0].work)),
        **settings,
    )  # fmt: skip
    assert path is not None
    return path[-1]


AT = torch.tensor([0.53, 1.0 / SCALES.period, 0.9, 0.2, 32.2, 3.2], dtype=torch.float64)


@pytest.mark.parametrize("num_steps", [20, pytest.param(PERIOD, marks=pytest.mark.slow)])
@pytest.mark.parametrize("coupling", [Coupling.IMPLICIT, Coupling.BOUNCE_BACK])
def test_gradients_equal_central_differences(coupling: Coupling, num_steps: int) -> None:
    """Through a quarter of a beat, and through a whole one."""
    got = torch.autograd.functional.jacobian(lambda p: swim(p, coupling, num_steps), AT)
    with torch.no_grad():
        for number, value in enumerate(AT):
            shift = torch.zeros(6, dtype=torch.float64)
            shift[number] = 1e-7 * max(1e-2, float(value))
            rise = swim(AT + shift, coupling, num_steps) - swim(AT - shift, coupling, num_steps)
            rise = rise / (2.0 * shift[number])
            error = (got[:, number] - rise).abs().max() / rise.abs().max()
            assert rise.abs().max() > 1e-6
            assert error < 1e-5, (number, error)


def test_segments_change_memory_and_not_the_gradient() -> None:
    whole, parts = (
        torch.autograd.functional.jacobian(
            lambda p, size=size: swim(p, Coupling.IMPLICIT, 20, segment=size), AT
        )
        for size in (20, 5)
    )
    assert torch.equal(whole, parts)
    fish = Fish(body_length=16)
    config = make_swimmer_config(SCALES, length_bl=4, height_bl=3, bodies=(fish,))
    place = torch.tensor([[32.0, 24.0]], dtype=torch.float64)
    state = FlowState(make_rest(config, 1), (make_body(place, math.pi * ONE, ONE / PERIOD),))
    few, many = (estimate_memory(state, config, num_steps=n)[0] for n in (100, 10_000))
    assert 5.0 < many / few < 15.0  # as the square root
    assert estimate_memory(state, config, num_steps=1)[0] > 9 * 8 * config.width * config.height


@pytest.mark.parametrize(("num_steps", "interval"), [(0, 1), (3, 2), (2, 4), (2, 0)])
def test_numbers_of_steps_that_do_not_fit_are_refused(num_steps: int, interval: int) -> None:
    config = make_swimmer_config(SCALES, length_bl=4, height_bl=3, bodies=())
    with pytest.raises(ValueError, match="positive multiple"):
        simulate(FlowState(make_rest(config, 1)), config, num_steps=num_steps, interval=interval)
