"""The code that Inductor would launch on a GPU, generated where there is none.

The parts of the step are traced as on a CPU, moved to an imaginary CUDA device and lowered to
Triton source, which is counted and not run. It needs the package triton, but no device.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import Any
from unittest import mock

import torch
from torch import Tensor
from torch._subclasses import FakeTensorMode
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

from experiments.benchmarks.contest import Entry, Settings
from experiments.benchmarks.flows import make_scales
from fishrl.physics import InPlaceSolver
from fishrl.physics.cases import make_swimmer_config

# What code generation asks of a device; the numbers are an H100's.
_PROPERTIES: dict[str, Any] = {
    "name": "imagined", "gcnArchName": "", "major": 9, "minor": 0, "warp_size": 32,
    "multi_processor_count": 132, "regs_per_multiprocessor": 65536,
    "max_threads_per_multi_processor": 2048, "max_threads_per_block": 1024,
    "shared_memory_per_block": 49152, "shared_memory_per_block_optin": 232448,
    "L2_cache_size": 50 * 2**20, "total_memory": 80 * 2**30,
}  # fmt: skip


def generate(function: Callable[..., Any], arguments: Sequence[Tensor], patches: Any) -> str:
    """Return the module that Inductor would write for ``function`` on CUDA."""
    from torch._inductor import config
    from torch._inductor.debug import DebugContext
    from torch._inductor.graph import GraphLowering
    from torch._inductor.virtualized import V

    graph, fake_mode = _trace(function, arguments), FakeTensorMode(allow_non_fake_inputs=True)
    with fake_mode:
        imagined = [
            torch.empty_strided(t.shape, t.stride(), dtype=t.dtype, device="cuda")
            for t in arguments
        ]
    asserts = {"size_asserts": False, "alignment_asserts": False}
    with _imagine_device(), config.patch(asserts | patches):
        lowering = GraphLowering(graph, example_inputs=imagined, is_inference=True)
        debug, handler = V.set_debug_handler(DebugContext()), V.set_graph_handler(lowering)
        with V.set_fake_mode(fake_mode), debug, handler:
            lowering.run(*imagined)
            return str(lowering.codegen()[0].value)


def _trace(function: Callable[..., Any], arguments: Sequence[Tensor]) -> GraphModule:
    """Trace as AOTAutograd would: mutations at the end, then in place where that is safe."""
    from torch._inductor.decomposition import select_decomp_table
    from torch._inductor.fx_passes.reinplace import reinplace_inplaceable_ops
    from torch._inductor.fx_utils import FakeTensorUpdater
    from torch._inductor.virtualized import V

    pure = torch.func.functionalize(function, remove="mutations")
    table = select_decomp_table()
    graph: GraphModule = make_fx(pure, decomposition_table=table, tracing_mode="fake")(*arguments)
    first = next(node for node in graph.graph.nodes if node.op == "placeholder")
    with V.set_fake_mode(first.meta["val"].fake_mode):
        reinplace_inplaceable_ops(FakeTensorUpdater(graph), graph.graph)
    for node in graph.graph.nodes:
        if "device" in node.kwargs:
            node.kwargs = {**node.kwargs, "device": torch.device("cuda")}
    graph.recompile()
    return graph


@contextmanager
def _imagine_device() -> Iterator[None]:
    """Answer what code generation asks of a device."""
    from torch._inductor.runtime.hints import DeviceProperties

    known = {f: v for f, v in _PROPERTIES.items() if f in DeviceProperties._fields}
    properties = DeviceProperties(type="cuda", index=0, cc=90, **known)
    answers: dict[str, Any] = {
        "torch.cuda.is_available": True,
        "torch.cuda.device_count": 1,
        "torch.cuda.current_device": 0,
        "torch.cuda.synchronize": None,
        "torch.cuda.get_device_capability": (9, 0),
        "torch.cuda.get_device_properties": SimpleNamespace(**_PROPERTIES),
        "torch.utils._triton.triton_hash_with_backend": "imagined",
        "torch._inductor.runtime.hints.DeviceProperties.create": properties,
    }
    with ExitStack() as stack:
        for name, answer in answers.items():
            stack.enter_context(mock.patch(name, mock.Mock(return_value=answer)))
        yield


def count(code: str) -> dict[str, int]:
    """Return how often the module launches, calls libraries, takes memory, loads and stores."""
    body = code.split("def call(")[1]
    return {
        "kernels": len(re.findall(r"triton_\w+\.run\(", body)),
        "library calls": body.count("extern_kernels."),
        "temporaries": body.count("= empty_strided_cuda("),
        "loads": code.count("tl.load("),
        "stores": code.count("tl.store(") + code.count("tl.atomic_add("),
    }


def make_code(settings: Settings) -> list[Entry]:
    """Count for two flows with a fish in each in one launch; ImportError without triton."""
    importlib.import_module("triton")
    config = make_swimmer_config(make_scales(settings.body_length // 2))
    solver = InPlaceSolver(config=config, num_envs=2, flows_per_launch=2, compile=False)
    entries = []
    for part, calls in solver.list_calls().items():
        patches = {"realize_opcount_threshold": 10} if part == "bodies" else {}
        facts = count(generate(*calls[0], patches))
        entries.append(Entry(label=f"cuda/{part}", name=part, num_steps=0, facts=facts))
    return entries
