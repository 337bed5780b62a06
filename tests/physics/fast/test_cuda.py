"""Steps that are compiled for a GPU and launched as CUDA graphs, against the eager ones of a CPU.

On the pretended device of ``tests/pretend`` Triton's interpreter runs the kernels that Inductor
writes: a second a step.
"""

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from torch import Tensor

from fishrl.physics import BounceBack, Cylinder, Fish, FlowConfig, ImmersedBoundary, InPlaceSolver
from fishrl.physics.bodies.motion import Free
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge
from fishrl.physics.fast.part import Repeater
from tests.physics.flows import start_solver

IS_PRETENDED = "device" in sys.modules
pytestmark = [
    pytest.mark.gpu,
    pytest.mark.compile,
    pytest.mark.xdist_group("cuda"),  # they share what they compile
    pytest.mark.skipif(find_spec("triton") is None, reason="needs the extra triton"),
]
STREAM = NonEquilibrium(velocity=(1.0, 0.0))
#: What swims or lies in two flows, where its centre and its nose are, the skin, and levels.
FISH = [[40.3, 30.2], [38.0, 31.7]], [math.pi, 2.8]
BEHIND = [[68.0, 24.0], [67.3, 37.0]], [math.pi, 3.0]
CASES = {
    "cylinder": ([(Cylinder(diameter=10), *FISH)], ImmersedBoundary(), 1),
    "free and commanded fish": (
        [(Fish(body_length=20, motion=Free()), *FISH), (Fish(body_length=20), *BEHIND)],
        BounceBack(),
        1,
    ),
    "fish on two levels": ([(Fish(body_length=20, motion=Free()), *FISH)], BounceBack(), 2),
}
#: Kernels of one step of the coarsest level, launched one after the other.
MOST_LAUNCHES = {"cylinder": 28, "free and commanded fish": 35, "fish on two levels": 84}
LONG = [pytest.mark.slow] if IS_PRETENDED else []
REPLAY = Repeater._replay  # recorded here, and nowhere else on the pretended device


def make_solver(name: str, *, device: str, compile: bool) -> InPlaceSolver:
    bodies, skin, levels = CASES[name]
    config = FlowConfig(
        width=91,
        height=61,
        tau=0.56,
        stream_speed=0.03,
        bodies=tuple(body for body, *_ in bodies),
        skin=skin,
        levels=levels,
        boundaries=Boundaries(left=STREAM, right=OpenEdge(), bottom=STREAM, top=STREAM),
    )
    where = (
        torch.tensor([body[i] for body in bodies], dtype=torch.float64).transpose(0, 1)
        for i in (1, 2)
    )
    settings = {"frequency": 1.0 / 300.0, "device": device, "compile": compile}
    solver = start_solver(config, *where, velocity=(1.0, 0.0), **settings)
    solver.body.position[0, 0] -= 3.0 * (levels - 1)  # its patch moves at once
    return solver


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Compile into a fresh folder that the processes of these tests share."""
    folder = tmp_path_factory.mktemp("inductor")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TORCHINDUCTOR_CACHE_DIR", str(folder))
        if IS_PRETENDED:
            import triton_host

            triton_host.interpret()
            patch.setattr(Repeater, "_replay", REPLAY)
        yield folder


def compute_error(there: Tensor, here: Tensor) -> float:
    """Return the norm of the difference, relative to what is expected."""
    return float((there.cpu() - here).norm() / here.norm())


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(
    ("parts", "tolerance"),
    [
        pytest.param([4], 1e-6, id="4 steps"),
        pytest.param([80, 80, 80], 1e-4, id="240 steps", marks=LONG),
    ],
)
def test_flow_on_a_gpu_equals_that_on_a_cpu(name: str, parts: list[int], tolerance: float) -> None:
    """In parts, so that graphs are recorded and replayed; steps are those of the coarsest level."""
    there = make_solver(name, device="cuda", compile=True)
    here = make_solver(name, device="cpu", compile=False)
    for num_steps in (CASES[name][2] * num for num in parts):
        there.advance_(num_steps)
        here.advance_(num_steps)
    assert there.populations().device.type == "cuda"
    assert torch.equal(there.corners.cpu(), here.corners)
    for grid in range(len(here.config.list_grids())):
        assert compute_error(there.populations(grid), here.populations(grid)) < tolerance
    for body, expected in zip(there.bodies, here.bodies, strict=True):
        assert compute_error(body.impulse, expected.impulse) < tolerance
        assert compute_error(body.position, expected.position) < tolerance
    assert not there.is_diverged().any()
    if IS_PRETENDED:
        _, pair, _ = there._batch._repeaters[0]
        for num_pairs, graph in pair._graphs.items():
            assert len(graph.calls) <= 2 * num_pairs * MOST_LAUNCHES[name]


COMPILE = """
import json, triton_host
triton_host.compile_only(80, 90)
from tests.physics.fast.test_cuda import make_solver
make_solver({name!r}, device="cuda", compile=True).compile()
print(json.dumps(triton_host.USAGE))
"""


@pytest.mark.skipif(not IS_PRETENDED, reason="the pretended device compiles for others")
@pytest.mark.parametrize(
    "name",
    [
        "cylinder",
        # compiling their kernels takes minutes
        pytest.param("free and commanded fish", marks=pytest.mark.slow),
        pytest.param("fish on two levels", marks=pytest.mark.slow),
    ],
)
def test_kernels_for_sm_80_and_sm_90_spill_no_registers(name: str, cache: Path) -> None:
    """In one at least of the configurations among which Inductor chooses by time."""
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", COMPILE.format(name=name)],
        cwd=root,
        env=os.environ
        | {
            "TRITON_INTERPRET": "0",
            "TRITON_CACHE_DIR": str(cache / "triton"),
            "PYTHONPATH": f"{root / 'tests/pretend'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
        },
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    usage: dict[str, list[str]] = json.loads(done.stdout.splitlines()[-1])
    assert {kernel[:5] for kernel in usage} == {"sm_80", "sm_90"}
    for kernel, said in usage.items():
        found = [re.findall(r"(\d+) bytes spill stores", log) for log in said]
        assert all(found), said
        spilled = [sum(map(int, functions)) for functions in found]
        assert min(spilled) == 0, f"{kernel}: {said}"
