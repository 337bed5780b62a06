"""Gradients through many steps, against central differences in float64."""

import math
from contextlib import nullcontext
from functools import partial
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics import (
    C_START,
    BodyConfig,
    BounceBack,
    Boundaries,
    Cylinder,
    Fish,
    FlowConfig,
    FlowState,
    Foil,
    Free,
    ImmersedBoundary,
    Scales,
    Section,
    Skin,
)
from fishrl.physics.bodies.motion import Bending, Commanded, Surging, Towed
from fishrl.physics.bodies.state import make_body
from fishrl.physics.cases import make_swimmer_config
from fishrl.physics.fast.compiled import compile_differentiable
from fishrl.physics.flow import make_params, make_rest, make_uniform
from fishrl.physics.rollout import simulate
from fishrl.physics.step import step
from tests.physics.flows import ONE, place_body, start_stream

PLACE = 32.2, 24.3, math.pi
SCALES = Scales.from_budget(body_length=16, reynolds=300.0, max_wall_speed=0.15)
PERIOD = 4 * round(SCALES.period / 4)
STREAM = {"boundaries": Boundaries.make_stream(), "stream_speed": 0.01}


def make_flow(*bodies: BodyConfig, **settings: Any) -> FlowConfig:
    return make_swimmer_config(SCALES, length_bl=4, height_bl=3, bodies=bodies, **settings)


def measure(state: FlowState) -> Tensor:
    """Return x, y and work of the fish, ``[B, 3]``."""
    (body,) = state.bodies
    return torch.cat((body.position, body.work[:, None]), 1)


def swim(values: Tensor, skin: Skin, num_steps: int, **settings: Any) -> Tensor:
    """Return ``measure`` of free fish in a stream; values ``[B, 10]`` are those of ``SWIM``."""
    tau, speed, frequency, amplitude, x, heading = values[:, :6].unbind(1)
    one = torch.ones_like(x)
    config = make_flow(Fish(body_length=16, motion=Bending()), skin=skin, **STREAM)
    params = make_params([config] * len(values))._replace(tau=tau, stream_speed=speed)
    body = make_body(torch.stack((x, 24.3 * one), 1), heading, frequency)
    body = body._replace(amplitude=amplitude, amplitude_goal=amplitude, beats=2.0 * one)

    def turn(number: int, state: FlowState) -> FlowState:
        (body,) = state.bodies
        command = {"turn": values[:, 6 + number], "turn_clock": 0.0 * one}
        return state._replace(bodies=(body._replace(**command, turn_steps=4 * PERIOD * one),))

    rest = torch.zeros(len(values), config.height, config.width, dtype=values.dtype)
    state = FlowState(make_uniform(rest, rest + speed[:, None, None], rest), (body,))
    _, path = simulate(
        state, config, params, num_steps=num_steps, interval=num_steps // 4, control=turn,
        record=measure, **settings,
    )  # fmt: skip
    assert path is not None
    return path[-1]


def escape(
    values: Tensor, skin: Skin, num_steps: int, *, beats: float = 0.5, place: Any = PLACE
) -> Tensor:
    """Return ``measure`` of free larvae after part of a C-start, from ``place`` x, y and heading.

    values ``[B, 8]`` are those of ``ESCAPE``.
    """
    larva = Fish(body_length=16, motion=Free(), strokes=C_START)
    config = make_flow(larva, skin=skin, **STREAM)
    params = make_params([config] * len(values))
    (own,) = params.bodies
    back = torch.cat((-values[:, :3], torch.zeros_like(values[:, :4])), 1)
    curve = own.curve._replace(change=torch.stack((values[:, :7], back), 1), phase=values[:, 7])
    params = params._replace(stream_speed=0.0 * values[:, 0], bodies=(own._replace(curve=curve),))
    one = torch.ones_like(values[:, 0])
    x, y, heading = (part * one for part in place)
    body = make_body(torch.stack((x, y), 1), heading, one / (25 * 16))._replace(beats=beats * one)
    state = FlowState(make_rest(config, len(values)), (body,))
    return measure(simulate(state, config, params, num_steps=num_steps)[0])


STROKE = C_START.sequence[0]
SWIM = [SCALES.tau, 0.01, 1.0 / SCALES.period, 0.9, 32.2, 3.2, 0.2, -0.1, 0.15, 0.1]
ESCAPE = [*STROKE.bend, *STROKE.wave, STROKE.lag, C_START.phase]
ALIKE = torch.tensor([[0.3, 1.0, 0.01]], dtype=torch.float64)  # x, y and work


#: Here a bent larva leaves a node from both sides in the second step.
unfold = partial(escape, beats=1.3542068, place=(32.2659817, 24.6740978, 5.9995065))
SOFT, SHARP = ImmersedBoundary(), BounceBack()
PATHS = (swim, SWIM), (escape, ESCAPE)


@pytest.mark.parametrize(
    ("motion", "at", "num_steps", "skin"),
    [
        (unfold, ESCAPE, 8, SHARP),
        *((*case, 20, skin) for case in PATHS for skin in (SOFT, SHARP)),
        *(
            pytest.param(*case, num_steps, skin, marks=pytest.mark.slow)
            for case, num_steps in zip(PATHS, (PERIOD, 400), strict=True)
            for skin in (SOFT, SHARP)
        ),
    ],
)
def test_gradients_equal_central_differences(
    motion: Any, at: list[float], num_steps: int, skin: Skin
) -> None:
    """Of viscosity, stream, gait, place, bends and strokes, through part of a beat or all."""
    values = torch.tensor([at], dtype=torch.float64, requires_grad=True)
    with pytest.warns(match="ImmersedBoundary") if skin is SHARP else nullcontext():
        result = (motion(values, skin, num_steps) * ALIKE).sum()
    (got,) = torch.autograd.grad(result, values)[0]
    # a sharp skin has kinks where a node comes to lie half a link away: stay between them
    is_long = skin is SHARP and num_steps > 20
    largest, tolerance = (4e-8, 5e-5) if is_long else (3e-6, 1e-5)
    shift = torch.diag((1e-5 * values[0].detach().abs()).clamp(max=largest))
    with torch.no_grad():
        there = (motion(values + torch.cat((shift, -shift)), skin, num_steps) * ALIKE).sum(1)
    rise = (there[: len(at)] - there[len(at) :]) / (2.0 * shift.diagonal())
    assert rise.abs().min() > 1e-6
    assert ((got - rise) / rise).abs().max() < tolerance


def test_segments_do_not_change_the_gradient() -> None:
    values = torch.tensor([SWIM], dtype=torch.float64, requires_grad=True)
    whole, parts = (
        torch.autograd.grad(swim(values, SOFT, 20, segment=size).sum(), values)[0]
        for size in (20, 5)
    )
    assert torch.equal(whole, parts)


@pytest.mark.slow  # compiles for minutes
def test_compiled_steps_have_the_same_gradient() -> None:
    values = torch.tensor([SWIM], dtype=torch.float64, requires_grad=True)
    eager, fast = (
        torch.autograd.grad(swim(values, BounceBack(), 20, compile=c).sum(), values)[0]
        for c in (False, True)
    )
    torch.testing.assert_close(fast, eager, rtol=1e-8, atol=0.0)


def test_compiled_graphs_can_be_retained() -> None:
    """``torch.autograd.functional.jacobian`` goes back through one graph several times."""

    def function(x: Tensor) -> tuple[Tensor]:
        return (x.sin().cumsum(0) * (2.0 + x.tanh()),)

    x = torch.linspace(0.1, 1.0, 8, dtype=torch.float64)
    compiled = compile_differentiable(function, [x])
    got, expected = (
        torch.autograd.functional.jacobian(lambda x, own=own: own(x)[0], x)
        for own in (compiled, function)
    )
    torch.testing.assert_close(got, expected)


@pytest.mark.parametrize("skin", [SOFT, SHARP])
def test_functional_transforms_agree(skin: Skin) -> None:
    """Forward derivatives of rows that vmap batches, and reverse ones without segments."""
    (values,) = torch.tensor([SWIM], dtype=torch.float64)

    def go(values: Tensor) -> Tensor:
        return swim(values[None], skin, 4, segment=4)[0]

    both = torch.stack((values, 1.01 * values))
    torch.testing.assert_close(torch.func.vmap(go)(both), swim(both, skin, 4))
    forward, reverse = torch.func.jacfwd(go)(values), torch.func.jacrev(go)(values)
    torch.testing.assert_close(forward, reverse, rtol=1e-9, atol=1e-12)
    with pytest.raises(RuntimeError, match="saved tensor hooks"):
        torch.func.grad(lambda v: swim(v[None], skin, 20).sum())(values)


LARVA = {"section": Section.LARVA, "thickness": 0.127, "strokes": C_START}
BODIES = {
    "free": Fish(body_length=16, motion=Free()),
    "bending": Fish(body_length=16, motion=Bending()),
    "commanded": Fish(body_length=16, motion=Commanded()),
    "C-start": Fish(body_length=16, motion=Free(), **LARVA),
    "surging": Foil(chord=16, motion=Surging(pitch=0.3, pivot=5.0)),
    "towed": Cylinder(diameter=8.0, motion=Towed()),
    "still": Cylinder(diameter=8.0),
}


@pytest.mark.parametrize("skin", [SOFT, SHARP])
@pytest.mark.parametrize("name", BODIES)
def test_no_gradient_from_rest_is_infinite(name: str, skin: Skin) -> None:
    """Compiled gradients differentiate every output, so that 0 times infinity would spread."""
    config = make_flow(BODIES[name], skin=skin)
    state = start_stream(config, place_body(*PLACE, 1 / PERIOD))._replace(clock=0.0 * ONE)
    leaves, form = pytree.tree_flatten((state, make_params([config])))
    leaves = [leaf.clone().requires_grad_(leaf.is_floating_point()) for leaf in leaves]
    before, params = pytree.tree_unflatten(leaves, form)
    results = [t for t in pytree.tree_leaves(step(before, config, params)) if t.requires_grad]
    torch.autograd.backward(results, [torch.zeros_like(result) for result in results])
    pairs, _ = pytree.tree_flatten_with_path((before, params))
    infinite = [
        pytree.keystr(path)
        for path, leaf in pairs
        if leaf.grad is not None and not leaf.grad.isfinite().all()
    ]
    assert infinite == []
