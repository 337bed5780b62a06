"""A device ``cuda:0`` on host memory, for a torch that was built without CUDA.

Import this module before torch and call ``install()`` before torchrl is imported, as
``sitecustomize.py`` does in every Python process whose environment has ``PRETEND_CUDA=1`` and this
folder on ``PYTHONPATH``: see ``make test-gpu``. It needs g++.

What it shows: tensors of two devices that meet in one operator, memory that is read before it is
written (fresh memory is NaN), a host that waits for the device (``Waits`` counts them by line), and
CUDA graphs whose recording waits or whose addresses change. What it cannot show: races, ordering of
streams and atomics, what ptxas or cuBLAS do, memory limits, several devices, and speed.
"""

from __future__ import annotations

import collections
import ctypes
import hashlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

SOURCE = Path(__file__).with_name("device.cpp")


def _build(root: Path) -> Path:
    """Compile the device, once for each version of it and of torch: half a minute."""
    word = hashlib.sha256(SOURCE.read_bytes() + (root / "version.py").read_bytes()).hexdigest()
    folder = Path(os.environ.get("PRETEND_CUDA_DIR", Path(tempfile.gettempdir()) / "pretend_cuda"))
    library = folder / f"{word[:16]}.so"
    if not library.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = library.with_suffix(f".{os.getpid()}")
        subprocess.run(
            ["g++", "-shared", "-fPIC", "-std=c++20", "-O1", f"-I{root}/include",
             f"-I{root}/include/torch/csrc/api/include", str(SOURCE),
             f"-L{root}/lib", "-lc10", "-ltorch_cpu", "-o", str(part)],
            check=True,
        )  # fmt: skip
        part.replace(library)
    return library


def _load() -> None:
    """Load the device before torch: it asks once, while it is imported, whether there is CUDA."""
    if "torch" in sys.modules:
        raise ImportError("import the pretended device before torch")
    spec = importlib.util.find_spec("torch")
    assert spec is not None and spec.origin is not None
    root = Path(spec.origin).parent
    for library in (root / "lib/libc10.so", root / "lib/libtorch_cpu.so", _build(root)):
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)


_load()

import torch  # noqa: E402
from torch import Tensor  # noqa: E402
from torch.utils import _pytree as pytree  # noqa: E402
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes  # noqa: E402

GENERATORS: tuple[torch.Generator, ...] = ()

PROPERTIES = SimpleNamespace(
    name="pretended GPU", major=9, minor=0, multi_processor_count=132,
    regs_per_multiprocessor=65536, max_threads_per_multi_processor=2048,
    max_threads_per_block=1024, warp_size=32,
    shared_memory_per_block=49152, shared_memory_per_block_optin=232448,
    shared_memory_per_multiprocessor=233472, L2_cache_size=50 * 2**20, total_memory=139 * 2**30,
    gcnArchName="", is_integrated=0, is_multi_gpu_board=0, uuid="0", clock_rate=1980000,
    memory_clock_rate=2619000, memory_bus_width=5120,
)  # fmt: skip


def _answer(value: Any) -> Any:
    return lambda *args, **kwargs: value


class Stream:
    """The one stream, on which all is done at once; and a moment on it."""

    device_index, device_type, stream_id, cuda_stream = 0, 1, 0, 0
    device = torch.device("cuda", 0)
    wait_stream = wait_event = record = wait = synchronize = _answer(None)
    query, elapsed_time = _answer(True), _answer(1.0)

    def __init__(self, *args: Any, **kwargs: Any) -> None: ...
    def record_event(self, event: Any = None) -> Stream:
        return event or Stream()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None: ...


_WAITING = {"_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_dim",
            "unique_consecutive", "equal", "repeat_interleave", "multinomial"}  # fmt: skip
_INDEXING = {"index", "index_put", "index_put_", "_index_put_impl_", "_unsafe_index",
             "_unsafe_index_put"}  # fmt: skip
_FREE = {"_unsafe_view", "lift_fresh", "resize_", "set_"}


def _is_gpu(thing: object) -> bool:
    return isinstance(thing, Tensor) and thing.device.type == "cuda"


def find_wait(func: Any, args: Any, kwargs: Any) -> str | None:
    """Return why a CUDA device would make the host wait for this operator, or None."""
    name = func._schema.name.removeprefix("aten::")
    leaves = [t for t in pytree.tree_leaves((args, kwargs)) if isinstance(t, Tensor)]
    if name in ("_to_copy", "copy_"):
        to = kwargs.get("device") or leaves[0].device
        kinds = torch.device(to).type, leaves[-1].device.type
        is_async = args[2:3] == (True,) or kwargs.get("non_blocking", False)
        if kinds[0] != kinds[1] and not is_async:
            return "copy to the host" if kinds[0] == "cpu" else "copy from the host"
    if not any(map(_is_gpu, leaves)):
        return None
    if name in _WAITING:
        return name
    for t in args[1] if name in _INDEXING else ():
        if isinstance(t, Tensor) and t.dtype in (torch.bool, torch.uint8):
            return f"{name} with a mask"
        if isinstance(t, Tensor) and t.device.type == "cpu":
            return f"{name} with indices on the host"
    return None


def _launches(func: Any, leaves: list[Any]) -> bool:
    """Return whether an operator launches something on the device, and is no view."""
    is_view = any(each.alias_info and not each.alias_info.is_write for each in func._schema.returns)
    name = func._schema.name.removeprefix("aten::")
    is_free = is_view or name in _FREE or name.removeprefix("new_").startswith("empty")
    return not is_free and any(map(_is_gpu, leaves))


class Waits(TorchDispatchMode):
    """Count what makes the host wait, by the innermost line of fishrl, and all launches."""

    active: ClassVar[list[Waits]] = []

    def __init__(self) -> None:
        super().__init__()
        self.lines, self.launches = collections.Counter(), 0

    def __enter__(self) -> Waits:
        self.active.append(self)
        return super().__enter__()

    def __exit__(self, *error: object) -> None:
        self.active.remove(self)
        super().__exit__(*error)

    @property
    def total(self) -> int:
        return sum(self.lines.values())

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if why := find_wait(func, args, kwargs or {}):
            frames = [
                f for f in traceback.extract_stack() if f"{os.sep}fishrl{os.sep}" in f.filename
            ]
            place = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "elsewhere"
            self.lines[f"{place} {why}"] += 1
        result = func(*args, **(kwargs or {}))
        self.launches += _launches(func, pytree.tree_leaves((args, kwargs, result)))
        return result


capturing: CUDAGraph | None = None


def _view_bytes(storage: Any) -> Tensor:
    return torch.empty(0, dtype=torch.uint8, device=storage.device).set_(storage)


class CUDAGraph:
    """Operators in the order they came, and their results' places."""

    def __init__(self, keep_graph: bool = False) -> None:
        self.calls: list[tuple[Any, Any, Any, Any]] = []
        self.saved: dict[int, tuple[Tensor, Tensor]] = {}

    def save(self, t: Tensor) -> None:
        """Remember what a storage held before it was first written."""
        if t.data_ptr() and _is_gpu(t):
            memory = _view_bytes(t.untyped_storage())
            if memory.data_ptr() not in self.saved:
                self.saved[memory.data_ptr()] = (memory, memory.clone())

    @torch.no_grad()
    def replay(self) -> None:
        for waits in Waits.active:
            waits.launches += 1
        with _disable_current_modes():  # of all its operators, the one launch is counted
            for func, args, kwargs, old in self.calls:
                new = func(*args, **kwargs)
                leaves = zip(pytree.tree_leaves(old), pytree.tree_leaves(new), strict=True)
                for place, value in leaves:
                    if _is_gpu(place) and place.data_ptr() != value.data_ptr():
                        place.copy_(value)

    def pool(self) -> tuple[int, int]:
        return (0, 0)

    def reset(self) -> None:
        self.calls.clear()


def do_or_record(call: Any) -> None:
    """Launch what is no operator of torch, such as a Triton kernel; or record it in a graph."""
    if capturing is None:
        call()
    else:
        capturing.calls.append((call, (), {}, None))


class _Capture(TorchDispatchMode):
    def __init__(self, into: CUDAGraph) -> None:
        super().__init__()
        self.into = into

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if why := find_wait(func, args, kwargs):
            raise RuntimeError(f"operation not permitted when stream is capturing: {func} ({why})")
        given = zip((each.name for each in func._schema.arguments), args, strict=False)
        values = dict(given) | kwargs
        for argument in func._schema.arguments:
            if argument.is_out or (argument.alias_info and argument.alias_info.is_write):
                for t in pytree.tree_leaves(values.get(argument.name)):
                    if isinstance(t, Tensor):
                        self.into.save(t)
        result = func(*args, **kwargs)
        is_ours = any(map(_is_gpu, pytree.tree_leaves((args, kwargs, result))))
        # operators of our own launch kernels, which are recorded by themselves
        is_call = func.namespace == "aten" and not func._schema.name.startswith("aten::empty")
        if is_ours and is_call:
            self.into.calls.append((func, args, kwargs, result))
        return result


class graph:  # as torch.cuda.graph
    def __init__(self, cuda_graph: CUDAGraph, *_: Any, **__: Any) -> None:
        self.graph, self.mode = cuda_graph, _Capture(cuda_graph)

    def __enter__(self) -> None:
        global capturing
        capturing = self.graph
        self.random = torch.get_rng_state()  # of this device, too
        self.mode.__enter__()

    def __exit__(self, *error: Any) -> None:
        global capturing
        capturing = None
        self.mode.__exit__(*error)
        for memory, before in self.graph.saved.values():  # nothing is done while it records
            memory.copy_(before)
        torch.set_rng_state(self.random)
        self.graph.saved.clear()


#: What torch's C++ side and ``torch.cuda`` answer to every question.
_ANSWERS_BELOW = {
    "getDeviceCount": 1, "init": None, "getDevice": 0, "setDevice": None,
    "isInBadFork": False, "getCurrentRawStream": 0, "exchangeDevice": 0, "maybeExchangeDevice": 0,
    "getArchFlags": "sm_90", "emptyCache": None,
}  # fmt: skip
_ANSWERS = {
    "is_available": True, "device_count": 1, "current_device": 0,
    "set_device": None, "empty_cache": None, "get_device_name": PROPERTIES.name,
    "get_device_capability": (9, 0), "get_device_properties": PROPERTIES, "_exchange_device": 0,
    "_maybe_exchange_device": 0, "is_bf16_supported": True, "memory_allocated": 0,
    "max_memory_allocated": 0, "reset_peak_memory_stats": None, "mem_get_info": (2**36, 2**36),
}  # fmt: skip


def install() -> None:
    """Bring the device into being; before torchrl and torch._dynamo are imported."""
    global GENERATORS
    if GENERATORS:
        return
    assert not torch.cuda.is_available(), "there is a real one"
    early = [name for name in ("torch._dynamo", "torchrl", "tensordict") if name in sys.modules]
    assert not early, f"imported before: {early}"
    cuda = torch.cuda
    cuda._initialized = True
    for name, value in _ANSWERS_BELOW.items():
        setattr(torch._C, f"_cuda_{name}", _answer(value))
    for name, value in _ANSWERS.items():
        setattr(cuda, name, _answer(value))
    cuda.synchronize = torch._C._cuda_synchronize = _synchronize
    cuda.is_current_stream_capturing = lambda *_: capturing is not None
    torch._C._cuda_isCurrentStreamCapturing = cuda.is_current_stream_capturing
    cuda.current_stream = cuda.default_stream = lambda *_: Stream()
    cuda.stream = lambda stream: stream or Stream()
    cuda.Stream = cuda.Event = Stream
    cuda.CUDAGraph = cuda.graphs.CUDAGraph = CUDAGraph
    cuda.graph = cuda.graphs.graph = graph
    GENERATORS = (torch.Generator(device="cuda"),)
    (generator,) = cuda.default_generators = GENERATORS
    cuda.manual_seed = cuda.manual_seed_all = lambda seed: generator.manual_seed(seed) and None
    cuda.get_rng_state = lambda *_: generator.get_state()
    cuda.get_rng_state_all = lambda: [generator.get_state()]
    cuda.set_rng_state = lambda state, *_: generator.set_state(state) and None
    cuda.set_rng_state_all = lambda states: generator.set_state(states[0]) and None
    _show_copies()
    _replace_storages()
    _add_lstm()


def _synchronize(*_: object) -> None:
    if capturing is not None:
        raise RuntimeError("operation not permitted when stream is capturing: synchronize")
    for waits in Waits.active:
        waits.lines["synchronize"] += 1


def _show_copies() -> None:
    """Let ``torch.tensor`` and its like copy from the host by an operator, which is counted."""
    make = torch.tensor

    def tensor(data: Any, *, dtype: Any = None, device: Any = None, **kwargs: Any) -> Tensor:
        return make(data, dtype=dtype, **kwargs).to(device or torch.get_default_device())

    def new(self: Tensor, data: Any, *, dtype: Any = None, device: Any = None) -> Tensor:
        return make(data, dtype=dtype or self.dtype).to(device or self.device)

    torch.tensor, Tensor.new_tensor = tensor, new


def _replace_storages() -> None:
    """torch.UntypedStorage(n, device="cuda") is not in a torch without CUDA; saving needs it."""
    base = torch.storage._StorageBase
    clone, move = base.clone, base.to

    def on_gpu(storage: Any) -> Any:
        return _view_bytes(storage).to("cuda", copy=True).untyped_storage()

    def clone_storage(self: Any) -> Any:
        return on_gpu(self) if self.device.type == "cuda" else clone(self)

    def to(self: Any, *, device: Any, non_blocking: bool = False) -> Any:
        if torch.device(device).type != "cuda" or self.device.type == "cuda":
            return move(self, device=device, non_blocking=non_blocking)
        return on_gpu(self)

    base.clone, base.to = clone_storage, to


def _add_lstm() -> None:
    """nn.LSTM without cuDNN calls a kernel that a CPU does not have."""

    def cell(gates: Tensor, hidden: Tensor, c: Tensor, *biases: Any) -> Any:
        total = sum((bias for bias in biases if bias is not None), gates + hidden)
        i, f, g, o = total.chunk(4, -1)
        c = f.sigmoid() * c + i.sigmoid() * g.tanh()
        return o.sigmoid() * c.tanh(), c, total

    for key in ("AutogradCUDA", "CUDA"):
        _LIBRARY.impl("_thnn_fused_lstm_cell", cell, key)


_LIBRARY = torch.library.Library("aten", "IMPL")
