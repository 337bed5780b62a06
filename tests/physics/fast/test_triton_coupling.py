"""The kernel that couples bodies and flow on a GPU, against the tensor operations.

Without a GPU Triton interprets it (``TRITON_INTERPRET=1``, see ``make test-gpu``): block by block
in numpy, some seconds a step.
"""

import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from fishrl.physics import Coupling, Cylinder, DCylinder, Fish, FlowConfig, Sponge
from fishrl.physics.bodies.motion import Bending, Free, Towed
from fishrl.physics.boundaries import Boundaries, NonEquilibrium, OpenEdge
from fishrl.physics.cases import PERIODIC
from fishrl.physics.collision import compute_equilibrium
from fishrl.physics.fast import batch as batches
from fishrl.physics.fast.gpu_body_parts import can_use_triton
from fishrl.physics.fast.part import Part
from fishrl.physics.immersed_boundary import DirectSolve, IterativeForcing

IS_REAL = torch.cuda.is_available() and "device" not in sys.modules
pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(find_spec("triton") is None, reason="Triton is not installed"),
    pytest.mark.skipif(
        not IS_REAL and os.environ.get("TRITON_INTERPRET") != "1",
        reason="there is no CUDA, and Triton is not interpreted",
    ),
]
STREAM = NonEquilibrium(velocity=(1.0, 0.0))
EDGES = Boundaries(left=STREAM, right=OpenEdge(), bottom=STREAM, top=STREAM)
FISH = Fish(body_length=16, motion=Free())
FLOW: dict[str, Any] = {"width": 56, "height": 40, "tau": 0.56, "stream_speed": 0.03}
FLOW["boundaries"] = EDGES
CASES: dict[str, dict[str, Any]] = {
    "free fish, periodic edges": {"bodies": (FISH,), "boundaries": PERIODIC},
    "bending and towed fish": {
        "bodies": (
            Fish(body_length=20, motion=Bending()),
            Fish(body_length=16, motion=Towed(), keeps_length=True, density_ratio=1.5),
        )
    },
    "fixed half disc in sponges": {
        "bodies": (DCylinder(diameter=9),),
        "sponges": (Sponge(length=30), Sponge(length=9, tau=0.8)),
    },
    "the paper's iteration": {"bodies": (FISH,), "force_solve": IterativeForcing.zhang(2)},
}


#: Sums in which most of what acts on the markers cancels, and how much acts: 2 rho ds u a marker,
#: with water that flows at 0.03, on 32 markers is about 2; torques have arms of up to 10 nodes.
ACTING = {"torque": 20.0, "force": 2.0, "impulse": 2.0}


def make_batch(config: FlowConfig, device: str, *, kernel: bool) -> batches.FlowBatch:
    """Return two flows of rough water, each with bodies 1.5 nodes apart, in mid-stroke."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batches, "can_use_triton", lambda *_: kernel)
        batch = batches.FlowBatch(
            [config, replace(config, tau=0.6)],
            group_size=2,
            device=torch.device(device),
            allocate=lambda n: torch.zeros(n, dtype=torch.uint8, device=device),
            compile=kernel,
        )
    batch.initialise_()
    if kernel:
        *_, buffers = find_coupling(batch).collect(batch.memory_of(0), 0)
        for buffer in buffers:
            buffer.fill_(torch.nan)  # nothing is read before it is written
    start = torch.tensor([[16.3, 12.2], [38.0, 15.7]])
    for index, body in enumerate(batch.flow.bodies):
        body.position.copy_(start + index * torch.tensor([1.0, 5.5]))
        body.heading.copy_(torch.tensor([math.pi, 2.9]))
        for name, value in {"frequency": 1 / 300, "phase": 0.3, "beats": 0.4, "turn": 0.3}.items():
            getattr(body, name).fill_(value)
        body.turn_steps.fill_(100.0)
        body.load.fill_(1e-3)
    generator = torch.Generator().manual_seed(0)
    rough = 0.03 * torch.randn(3, 2, config.height, config.width, generator=generator)
    still = compute_equilibrium(0.1 * rough[0], rough[1], rough[2])
    batch.first.write_(torch.arange(2, device=device), torch.stack(still, 1).to(device))
    return batch


def find_coupling(batch: batches.FlowBatch) -> Part:
    """Return the part that launches the kernels."""
    (found,) = (part for part in batch.stepper.parts if part.name == "kernels")
    return found


def advance(config: FlowConfig, *, kernel: bool) -> tuple[Tensor, dict[str, Tensor]]:
    """Return populations and all numbers, by name, after an even and an odd step."""
    device = "cuda" if kernel and torch.cuda.is_available() else "cpu"
    batch = make_batch(config, device, kernel=kernel)
    batch.advance_(2, [0])
    leaves, _ = pytree.tree_flatten_with_path(batch.flow)
    numbers = {pytree.keystr(path): t.cpu() for path, t in leaves}
    return torch.stack(batch.first.read(), 1).cpu(), numbers


def compute_error(got: Tensor, expected: Tensor) -> float:
    """Return the largest difference, relative to the largest value."""
    return float((got - expected).abs().max() / expected.abs().max())


@pytest.mark.parametrize("name", CASES)
def test_the_kernel_equals_the_tensor_operations(name: str) -> None:
    """In single precision: its round-off is 6e-8."""
    config = FlowConfig(**{**FLOW, **CASES[name]})
    f, numbers = advance(config, kernel=True)
    expected_f, expected = advance(config, kernel=False)
    assert compute_error(f, expected_f) < 1e-6
    for key, value in expected.items():
        acting = next((scale for part, scale in ACTING.items() if part in key), 0.0)
        torch.testing.assert_close(
            numbers[key], value, rtol=1e-5, atol=1e-8 + 1e-6 * acting, msg=key
        )


def run_backwards(patch: pytest.MonkeyPatch) -> None:
    """Let the interpreter run the programs of a launch in the opposite order."""
    from triton.runtime.interpreter import interpreter_builder as builder

    set_index = builder.set_grid_idx

    def set_opposite(*index: int) -> None:
        set_index(*(n - 1 - i for n, i in zip(builder.grid_dim, index, strict=True)))

    patch.setattr(builder, "set_grid_idx", set_opposite)


def test_equal_runs_are_equal_to_the_bit_in_whatever_order_programs_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The 72 markers belong to five programs, whose neighbours share nodes."""
    config = FlowConfig(**{**FLOW, **CASES["bending and towed fish"]})
    f, numbers = advance(config, kernel=True)
    if not IS_REAL:
        run_backwards(monkeypatch)
    again, numbers_again = advance(config, kernel=True)
    assert torch.equal(f, again)
    for key, value in numbers.items():
        assert torch.equal(value, numbers_again[key]), key


@pytest.mark.parametrize(
    ("changes", "is_taken"),
    [
        ({}, True),
        ({"force_solve": DirectSolve()}, False),
        ({"coupling": Coupling.EXPLICIT}, False),
        ({"bodies": (Cylinder(diameter=600),)}, True),
        ({"bodies": tuple(Fish(body_length=200, motion=Free()) for _ in range(6))}, False),
    ],
)
def test_flows_beyond_the_kernel_keep_the_tensor_operations(
    changes: dict[str, Any], is_taken: bool
) -> None:
    config = FlowConfig(**{**FLOW, "width": 700, "height": 700, "bodies": (FISH,), **changes})
    assert can_use_triton(config, torch.device("cuda")) is is_taken
    assert not can_use_triton(config, torch.device("cpu"))


COMPILE = """
import subprocess, sys, torch, triton
from types import SimpleNamespace
from triton.backends.compiler import GPUTarget
from triton.runtime.driver import driver
from fishrl.physics import DCylinder, Fish, FlowConfig, Storage
from fishrl.physics.fast import triton_coupling
from tests.physics.fast.test_triton_coupling import find_coupling, make_batch

target = GPUTarget("cuda", int(sys.argv[1]), 32)
driver.set_active(SimpleNamespace(
    get_current_target=lambda: target, get_current_device=lambda: 0, get_current_stream=lambda *_: 0
))
made = []

class Compiled:
    def __init__(self, kernel):
        self.kernel = kernel
    def __getitem__(self, grid):
        return lambda *args, **kwargs: made.append(self.kernel.warmup(*args, grid=grid, **kwargs))

torch.library.wrap_triton = Compiled
config = FlowConfig(width=400, height=300, tau=0.51, storage=Storage[sys.argv[2]],
                    bodies=(Fish(body_length=100), DCylinder(diameter=50)))
batch = make_batch(config, "cpu", kernel=True)
coupling = find_coupling(batch)
coupling.run(*batch.first.arguments[coupling][0])
for kernel in made:
    with open(sys.argv[3], "wb") as file:
        file.write(kernel.asm["cubin"])
    command = [triton.knobs.nvidia.cuobjdump.path, "-res-usage", sys.argv[3]]
    usage = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    print(kernel.name, "atomics", kernel.asm["ptx"].count("atom."), usage.splitlines()[-1])
"""


@pytest.mark.parametrize(("architecture", "storage"), [(80, "FLOAT32"), (90, "FLOAT16")])
def test_the_binary_spills_no_registers_and_has_no_atomics(
    architecture: int, storage: str, tmp_path: Any
) -> None:
    """For the paper's largest case, a fish of 100 nodes behind a half disc; needs no device."""
    done = subprocess.run(
        [sys.executable, "-c", COMPILE, str(architecture), storage, str(tmp_path / "cubin")],
        env=os.environ | {"TRITON_INTERPRET": "0", "PRETEND_CUDA": "0"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    lines = done.stdout.splitlines()
    assert len(lines) == 2, done.stdout
    for line in lines:
        assert "atomics 0 " in line
        assert "STACK:0 " in line
        assert "LOCAL:0 " in line
        assert re.search(r"REG:(\d+)", line)
