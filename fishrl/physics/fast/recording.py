"""Record what a compiled part calls, and repeat that: for a CPU what a CUDA graph is for a GPU.

Between the generated kernels Inductor's Python makes scratch tensors and views, at every call: two
thirds of the time of a small flow's bodies. But shapes and addresses never change. So a part runs
once while its kernels note their arguments, and is from then on the list of these calls.
"""

import ast
import inspect
import sys
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from types import CodeType, FrameType
from typing import Any

from torch import Tensor

Call = Callable[[], object]
#: What generated code may call: these leave nothing to do when the kernels are repeated.
_MAKES_TENSORS = {"args.clear", "empty_strided_cpu", "reinterpret_tensor"}
_READS_SIZES = (".size", ".stride")
_KERNEL = "cpp_fused"
_CHECKS = "assert_size_stride"  # once: shapes never change


def record(
    run: Callable[..., object], arguments: Sequence[Tensor], scratch: list[Tensor]
) -> list[Call]:
    """Run a function of tensors once, and return the calls that do the same again.

    Args:
        run: compiled or not. If it is not, or if the generated code does anything besides calling
            kernels, the only call is ``run(*arguments)``.
        arguments: tensors whose memory stays where it is.
        scratch: memory between the kernels; filled at first, and shared by all recordings of the
            same function that never run at the same time.
    """
    calls: list[Call] = []
    replaced: list[tuple[dict[str, Any], dict[str, Any]]] = []

    def watch(frame: FrameType, event: str, argument: object) -> None:
        names = frame.f_globals
        if event == "call" and frame.f_code.co_name == "call" and "extern_kernels" in names:
            _set_profiler(before)
            if _calls_kernels_alone(frame.f_code):
                own = _note_calls(names, calls, scratch)
                replaced.append((names, {name: names[name] for name in own}))
                names.update(own)

    before = sys.getprofile()
    sys.setprofile(watch)  # to find the generated module: it lies behind layers of torch
    try:
        run(*arguments)
    finally:
        _set_profiler(before)
        for names, own in replaced:
            names.update(own)
    return calls if replaced else [partial(run, *arguments)]


def _set_profiler(profiler: Any) -> None:
    """Let a profiler of the caller continue; one in C, as cProfile's, sets itself."""
    if profiler is None or callable(profiler):
        sys.setprofile(profiler)
    else:
        profiler.enable()


def _calls_kernels_alone(code: CodeType) -> bool:
    """Return whether generated code has no branches, and makes tensors and calls kernels only."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(code)))
    except OSError:  # the file is gone
        return False
    branches = ast.If, ast.For, ast.While, ast.Try, ast.With, ast.IfExp
    return not any(isinstance(node, branches) for node in ast.walk(tree)) and all(
        _is_plain(node) for node in ast.walk(tree) if isinstance(node, ast.Call)
    )


def _is_plain(call: ast.Call) -> bool:
    name = ast.unparse(call.func)
    if name.startswith("extern_kernels."):  # of torch; without ``out`` they make their results
        return any(keyword.arg == "out" for keyword in call.keywords)
    return (
        name in _MAKES_TENSORS or name.endswith(_READS_SIZES) or name.startswith((_KERNEL, _CHECKS))
    )


def _note_calls(names: dict[str, Any], calls: list[Call], scratch: list[Tensor]) -> dict[str, Any]:
    """Return the kernels of a generated module as functions that note themselves in ``calls``."""

    def note(kernel: Callable[..., object]) -> Callable[..., object]:
        def run(*args: Any, **kwargs: Any) -> object:
            calls.append(partial(kernel, *args, **kwargs))
            return kernel(*args, **kwargs)

        return run

    class Extern:
        def __getattr__(self, name: str) -> Callable[..., object]:
            return note(getattr(names_before["extern_kernels"], name))

    names_before = dict(names)
    used = iter(list(scratch))

    def take(*shape: Any) -> Tensor:
        tensor: Tensor | None = next(used, None)
        if tensor is None:
            scratch.append(tensor := names_before["empty_strided_cpu"](*shape))
        return tensor

    kernels = {name: note(each) for name, each in names.items() if name.startswith(_KERNEL)}
    return {**kernels, "extern_kernels": Extern(), "empty_strided_cpu": take}
