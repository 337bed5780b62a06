"""Compile a function that mutates its tensors, without guards and without copies.

``torch.compile`` checks guards on every call (about 100 us with many tensors) and functionalises
views of one buffer into whole-buffer copies. Tracing the function once and handing the graph to
Inductor with *the views themselves as inputs* avoids both. In return, the caller guarantees that
shapes, strides and types never change and that mutated inputs do not overlap within one call.
"""

import logging
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import CellType
from typing import Any

import torch
from torch import Tensor

from fishrl.files import staged
from fishrl.physics.cache_key import hash_sources, make_key

logger = logging.getLogger(__name__)

InPlaceFunction = Callable[..., Any]

# Fused multiply-add, and no check of the arguments' shapes at each call: they never change.
_SETTINGS: dict[str, object] = {
    "cpp.enable_floating_point_contract_flag": "fast",
    "size_asserts": False,
    "alignment_asserts": False,
    "cpp.vec_isa_ok": True,  # the processor's flags tell; else a program is compiled to probe each
}


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


def is_own(thing: object) -> bool:
    """Return whether ``thing`` consists of plain values and dataclasses of this package alone.

    Then its ``repr`` and the package's sources determine it completely.
    """
    if isinstance(thing, list | tuple):
        return all(map(is_own, thing))
    if thing is None or isinstance(thing, bool | int | float | str | torch.dtype):
        return True
    kind = thing if isinstance(thing, type) else type(thing)
    if not kind.__module__.startswith("fishrl.physics."):
        return False
    if isinstance(thing, type) or not is_dataclass(thing):
        return True
    return all(is_own(getattr(thing, field.name)) for field in fields(thing))


def compile_inplace(
    function: InPlaceFunction,
    example: Sequence[Tensor],
    *,
    name: str | None = None,
    **patches: object,
) -> InPlaceFunction:
    """Compile ``function(*tensors)``, which may mutate its arguments; itself without a compiler.

    Args:
        function: traceable, of tensors alone; a tuple of tensors or nothing is returned.
        example: arguments of the shapes, strides and types that every call will have. They are not
            touched.
        name: key of everything that determines the function, apart from this package's sources and
            ``example``. The result is stored under it next to Inductor's cache, and other processes
            load it without tracing. None stores nothing.
        **patches: Inductor settings.

    Raises:
        ChildProcessError: if the compiler fails.
    """
    device = example[0].device
    if find_compiler_problem(device.type):
        return function
    settings = {**_SETTINGS, **patches}
    path = None if name is None else _locate_artefact(name, example, settings)
    if path is not None and (kept := _load(path, settings)) is not None:
        return _reach_code(kept)
    from torch._inductor import standalone_compile
    from torch.fx.experimental.proxy_tensor import make_fx

    twins = [_make_twin(t) for t in example]
    graph, options = make_fx(function)(*twins), {"config_patches": settings}
    try:
        compiled = standalone_compile(
            graph, [*twins], dynamic_shapes="from_example_inputs", aot=True, options=options
        )
    except RuntimeError as error:
        said = str(error).rpartition("Output:")[2].strip()  # by the C++ compiler
        raise ChildProcessError(f"the compiler failed: {said.partition(chr(10))[0]}") from error
    if path is not None:
        _save(path, compiled.serialize())  # type: ignore[attr-defined]
    return _reach_code(compiled)


def _reach_code(artefact: InPlaceFunction) -> InPlaceFunction:
    """Return the compiled code without the layers around it, which cost 5 to 10 us at each call.

    They serve autograd and caches. Where no code is found in them, they stay.
    """
    from torch._inductor.output_code import CompiledFxGraph

    layers: list[Any] = [artefact]
    for layer in layers:  # which grow by what each of them holds
        if isinstance(layer, CompiledFxGraph) and layer.current_callable is not None:
            graph: Any = layer
            return lambda *tensors: graph.current_callable(list(tensors))
        cells = [cell for cell in getattr(layer, "__closure__", None) or () if cell != CellType()]
        held = [*(cell.cell_contents for cell in cells), *getattr(layer, "__dict__", {}).values()]
        layers += [h for h in held if callable(h) and all(h is not other for other in layers)]
    return artefact


def _locate_artefact(name: str, example: Sequence[Tensor], settings: dict[str, object]) -> Path:
    from torch._inductor.runtime.cache_dir_utils import cache_dir

    device = example[0].device
    if device.type == "cuda":
        machine = f"{torch.cuda.get_device_name(device)}, {device}"  # the code holds its index
    else:
        machine = f"{torch.backends.cpu.get_cpu_capability()}, {torch.get_num_threads()} threads"
    arguments = [(tuple(t.shape), t.stride(), t.dtype) for t in example]
    key = make_key(
        name, hash_sources(), torch.__version__, sys.version, machine, arguments, settings
    )
    return Path(cache_dir()) / "fishrl" / f"{key}.bin"


def _load(path: Path, settings: dict[str, object]) -> InPlaceFunction | None:
    """Return what is kept at ``path``; None if there is nothing that can be used.

    The settings count here too: they are part of how Inductor finds the machine code.
    """
    if not path.exists():
        return None
    from torch._inductor.standalone_compile import AOTCompiledArtifact

    try:
        with torch._inductor.config.patch(settings):
            return AOTCompiledArtifact.deserialize(path.read_bytes())
    except Exception as error:  # noqa: BLE001  # any damage: compile again
        logger.warning("%s cannot be used (%s): compiling again", path, error)
        return None


def _save(path: Path, content: bytes) -> None:
    """Keep ``content``; readers see all of it or nothing."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with staged(path) as part:
            part.write_bytes(content)
    except OSError as error:
        logger.warning("the compiled step cannot be kept (%s): it is compiled every time", error)
