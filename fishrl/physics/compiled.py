"""Compile a function that mutates its tensors, without guards and without copies.

``torch.compile`` checks guards on every call (about 100 us with many tensors) and functionalises
views of one buffer into whole-buffer copies. Tracing the function once and handing the graph to
Inductor with *the views themselves as inputs* avoids both. The price: the caller promises that
shapes, strides and types never change and that mutated inputs do not overlap within one call.
"""

import logging
import shutil
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

logger = logging.getLogger(__name__)

Step = Callable[..., Any]


@cache
def find_compiler_problem(device_type: str) -> str | None:
    """Return why nothing can be compiled for ``device_type``, or None; logged once."""
    problem = None
    if device_type == "cpu" and not (shutil.which("g++") or shutil.which("clang++")):
        problem = "no C++ compiler (g++ or clang++) on the path"
    elif not hasattr(torch._inductor, "standalone_compile"):
        problem = f"torch {torch.__version__} has no torch._inductor.standalone_compile"
    if problem:
        logger.warning("%s: the flow runs eagerly, about 10 times slower", problem)
    return problem


def _make_twin(t: Tensor) -> Tensor:
    """Return a tensor of the same shape and strides with storage of its own.

    It starts one element into its storage: on a GPU, Inductor would clone arguments that are less
    aligned than the example, and the views of odd steps are.
    """
    size = 1 + sum((n - 1) * s for n, s in zip(t.shape, t.stride(), strict=True))
    store = torch.zeros(size + 1, dtype=t.dtype, device=t.device)
    return store.as_strided(t.shape, t.stride(), 1).copy_(t)


def compile_inplace(function: Step, example: Sequence[Tensor], **patches: object) -> Step:
    """Compile ``function(*tensors)``, which may mutate its arguments.

    Args:
        function: traceable, of tensors alone; a tuple of tensors or nothing is returned.
        example: arguments of the shapes, strides and types that every call will have. They are not
            touched.
        **patches: Inductor settings.

    Returns:
        The compiled function, or ``function`` itself where no compiler is present.
    """
    device_type = example[0].device.type
    if find_compiler_problem(device_type):
        return function
    from torch._inductor import standalone_compile
    from torch.fx.experimental.proxy_tensor import make_fx

    twins = [_make_twin(t) for t in example]
    graph = make_fx(function)(*twins)
    settings = {"cpp.enable_floating_point_contract_flag": "fast", **patches}
    compiled = standalone_compile(
        graph,
        [*twins],
        dynamic_shapes="from_example_inputs",
        options={"config_patches": settings},
    )
    return compiled
