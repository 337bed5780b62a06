"""Flows on a GPU, whose steps are launched as CUDA graphs, against the eager ones of a CPU."""

import math
from collections.abc import Sequence

import pytest
import torch

from fishrl.physics import Cylinder, Fish, FlowConfig, InPlaceSolver
from fishrl.physics.bodies.motion import Free
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.compile,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA"),
]
STREAM = NonEquilibrium(velocity=(1.0, 0.0))
PLACES = torch.tensor([[40.3, 30.2], [38.0, 31.7]], dtype=torch.float64)
HEADINGS = torch.tensor([math.pi, 2.8], dtype=torch.float64)
BODIES = {"free fish": Fish(body_length=20, motion=Free()), "cylinder": Cylinder(diameter=10)}


def make_config(name: str) -> FlowConfig:
    return FlowConfig(
        width=90,
        height=60,
        tau=0.56,
        stream_speed=0.03,
        bodies=(BODIES[name],),
        boundaries=Boundaries(left=STREAM, right=OpenEdge(), bottom=STREAM, top=STREAM),
    )


def run(config: FlowConfig, parts: Sequence[int], *, device: str, compile: bool) -> InPlaceSolver:
    solver = InPlaceSolver(
        config=config,
        num_envs=2,
        frequency=1.0 / 300.0,
        device=device,
        compile=compile,
        num_workers=0,
    )
    rows = torch.ones(2, dtype=torch.bool, device=device)
    solver.reset_(rows, PLACES, HEADINGS, velocity=(1.0, 0.0))
    for num_steps in parts:
        solver.advance_(num_steps)
    return solver


@pytest.mark.parametrize("name", BODIES)
def test_a_flow_on_a_gpu_equals_the_flow_on_a_cpu(name: str) -> None:
    """After 240 steps, in parts, so that graphs are recorded and replayed; single precision."""
    there = run(make_config(name), (80, 80, 80), device="cuda", compile=True)
    here = run(make_config(name), (240,), device="cpu", compile=False)
    assert there.populations().device.type == "cuda"
    f, expected = there.populations().cpu(), here.populations()
    assert float((f - expected).abs().max()) < 1e-4 * float(expected.abs().max())
    assert float((there.markers().cpu() - here.markers()).abs().max()) < 1e-4
    torch.testing.assert_close(there.body.impulse.cpu(), here.body.impulse, rtol=1e-4, atol=1e-4)
    assert not there.is_diverged().any()
