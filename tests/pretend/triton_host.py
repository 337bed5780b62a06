"""Inductor's Triton kernels on the pretended device.

``interpret()`` runs them on the host, block by block in numpy (with ``TRITON_INTERPRET=1`` in the
environment before Triton is imported); blocks are larger than on a GPU, so that there are fewer.
``compile_only()`` compiles Inductor's kernels to binaries, which cannot run, and keeps what ptxas
says of their registers. A process can do one of the two.
"""

import contextlib
import io
import sys
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import triton
import triton.language as tl
from torch import Tensor
from torch._inductor.codegen import wrapper
from torch._inductor.runtime import triton_helpers, triton_heuristics
from triton import knobs
from triton.backends.compiler import GPUTarget
from triton.runtime import interpreter
from triton.runtime.driver import driver


def _set_up() -> None:
    """Give Triton and Inductor the device that they ask for."""
    current = SimpleNamespace(
        get_current_target=lambda: GPUTarget("cuda", 90, 32),
        get_current_device=lambda: 0,
        get_current_stream=lambda *_: 0,
        get_device_interface=lambda: torch.cuda,
        get_active_torch_device=lambda: torch.device("cuda", 0),
    )
    if "device" not in sys.modules:
        return  # there is a real one
    driver.set_active(current)
    triton_helpers.set_driver_to_gpu = lambda: None
    torch._C._dynamo.guards._empty_strided_cuda = lambda size, stride, dtype: torch.empty_strided(
        size, stride, dtype=dtype, device="cuda"
    )
    # what is faster is tried out on a real device only
    torch._inductor.config.shape_padding = False
    wrapper.PythonWrapperCodegen.generate_and_run_autotune_block = lambda self: None


# ------------------------------------------------------------------------------------- interpreted


@cache
def interpret() -> None:
    """Let ``compile=True`` work on the pretended device."""
    import device

    assert knobs.runtime.interpret, "TRITON_INTERPRET=1 must be set before triton is imported"
    _set_up()
    torch.utils._triton.triton_hash_with_backend = lambda: "interpreted"
    triton_helpers.libdevice = _Library()
    # memory of the pretended device is the host's: nothing is copied
    interpreter.GridExecutor._init_args_hst = lambda self, args, kwargs: (args, kwargs)
    interpreter.GridExecutor._restore_args_dev = lambda self, *_: None
    execute = interpreter.GridExecutor.__call__
    run = triton_heuristics.CachingAutotuner.run

    def launch(self: Any, *args: Any, **kwargs: Any) -> None:
        name = self.fn.__name__
        for t in (*args, *kwargs.values()):
            assert not isinstance(t, Tensor) or t.is_cuda, f"{name} got a tensor on {t.device}"
        device.do_or_record(lambda: execute(self, *args, **kwargs))

    def run_in_large_blocks(self: Any, *args: Any, **kwargs: Any) -> Any:
        """Choose the largest blocks that Inductor's code allows, but none larger than tensors."""
        (config,) = self.configs[:1]
        names = [name for name in self.triton_meta["signature"] if name not in config.kwargs]
        sizes = dict(zip(names, args, strict=False))
        if "XBLOCK" in config.kwargs and "xnumel" in sizes:
            config.kwargs["XBLOCK"] = min(4096, triton.next_power_of_2(sizes["xnumel"]))
        return run(self, *args, **kwargs)

    interpreter.GridExecutor.__call__ = launch
    triton_heuristics.CachingAutotuner.run = run_in_large_blocks


_NUMPY = {
    "abs": np.abs, "atan": np.arctan, "atan2": np.arctan2, "ceil": np.ceil, "copysign": np.copysign,
    "cos": np.cos, "exp": np.exp, "fabs": np.abs, "floor": np.floor, "fmod": np.fmod,
    "hypot": np.hypot, "isinf": np.isinf, "isinfd": np.isinf, "isnan": np.isnan, "isnand": np.isnan,
    "log": np.log, "nearbyint": np.rint, "pow": np.power, "rint": np.rint, "sin": np.sin,
    "sqrt": np.sqrt, "tan": np.tan, "tanh": np.tanh, "trunc": np.trunc,
    "rsqrt": lambda x: 1.0 / np.sqrt(x), "llrint": lambda x: np.rint(x).astype(np.int64),
    "fma": lambda a, b, c: a * b + c,
}  # fmt: skip


class _Library:
    """CUDA's libdevice, in numpy."""

    def __getattr__(self, name: str) -> Any:
        if name not in _NUMPY:
            raise AttributeError(name)

        def call(*args: Any) -> Any:
            first = next(a for a in args if isinstance(a, tl.tensor))
            with np.errstate(all="ignore"):
                raw = (a.handle.data if isinstance(a, tl.tensor) else a for a in args)
                value = np.asarray(_NUMPY[name](*raw))
            kind = {"bool": tl.int1, "int64": tl.int64}.get(value.dtype.name, first.dtype)
            if kind is first.dtype:
                value = value.astype(first.handle.data.dtype)
            shape = first.type.with_element_ty(kind) if first.type.is_block() else kind
            return tl.tensor(interpreter.TensorHandle(value, kind), shape)

        return call


# ---------------------------------------------------------------------------------------- compiled

#: Of each architecture and kernel: what ptxas used of registers and memory, by configuration.
USAGE: dict[str, list[str]] = {}


@cache
def compile_only(*capabilities: int) -> None:
    """Let Inductor's kernels be compiled for GPUs of these compute capabilities, such as 90."""
    assert not knobs.runtime.interpret, "TRITON_INTERPRET must not be set"
    _set_up()
    torch._inductor.config.compile_threads = 1
    knobs.compilation.always_compile = knobs.nvidia.dump_ptxas_log = True

    def precompile(self: Any, *args: Any, **kwargs: Any) -> None:
        what = hash((self.fn.src, str(self.triton_meta["signature"]), str(self.configs)))
        for capability in capabilities:
            kernel = f"sm_{capability} {self.fn.__name__} {what:x}"
            if kernel in USAGE:  # the same kernel in another part
                continue
            self.device_props = self.device_props._replace(cc=capability)
            USAGE[kernel] = []
            for config in self.configs:
                log = io.StringIO()
                with contextlib.redirect_stdout(log):
                    self._precompile_config(config)
                USAGE[kernel].append(f"{config}: {log.getvalue()}")

    triton_heuristics.CachingAutotuner.precompile = precompile
