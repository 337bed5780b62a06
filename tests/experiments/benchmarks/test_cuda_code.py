"""Counting what generated GPU code does, and generating it where triton is installed."""

import importlib.util

import pytest
import torch

from experiments.benchmarks.cuda_code import count, generate

CODE = """
def triton_poi_fused_0(in_ptr0, out_ptr0, xnumel):
    tmp0 = tl.load(in_ptr0 + x0)
    tl.store(out_ptr0 + x0, tmp0)
    tl.atomic_add(out_ptr0 + x0, tmp0)
def call(args):
    buf0 = empty_strided_cuda((2, 3), (3, 1), torch.float32)
    triton_poi_fused_0.run(arg0_1, buf0, 6, stream=raw_stream0)
    extern_kernels.bmm(buf0, arg1_1, out=buf1)
"""


def test_launches_library_calls_and_accesses_are_counted() -> None:
    assert count(CODE) == {
        "kernels": 1,
        "library calls": 1,
        "temporaries": 1,
        "loads": 1,
        "stores": 2,
    }


@pytest.mark.skipif(not importlib.util.find_spec("triton"), reason="triton is not installed")
def test_a_pass_in_place_is_one_kernel_that_takes_no_memory() -> None:
    def double(x: torch.Tensor) -> None:
        x.mul_(2.0)

    counted = count(generate(double, [torch.ones(64)], {}))
    assert counted == {"kernels": 1, "library calls": 0, "temporaries": 0, "loads": 1, "stores": 1}
