"""Compile a function that mutates its tensors, without guards and without copies.

``torch.compile`` checks guards on every call (about 100 us with many tensors) and functionalises
views of one buffer into whole-buffer copies. Tracing the function once and handing the graph to
Inductor with *the views themselves as inputs* avoids both. In return, the caller guarantees that
shapes, strides and types never change and that mutated inputs do not overlap within one call.
"""

import gzip
import logging
import pickle
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any, Literal, cast

import torch
from torch import Tensor

from fishrl.files import staged
from fishrl.locks import take_lock
from fishrl.physics.cache_key import hash_sources, make_key
from fishrl.physics.fast.inductor import find_compiler_problem, set_up_inductor, without_collector

logger = logging.getLogger(__name__)

InPlaceFunction = Callable[..., Any]


@without_collector()
def compile_inplace(
    function: InPlaceFunction,
    example: Sequence[Tensor],
    *,
    name: str | None = None,
    num_varying: int = 0,
    waits: bool = True,
    **patches: object,
) -> InPlaceFunction | None:
    """Compile ``function(*tensors)``, which may mutate its arguments; itself without a compiler.

    Args:
        function: traceable, of tensors alone; a tuple of tensors or nothing is returned.
        example: arguments of the shapes, strides and types that every call will have. They are not
            touched.
        num_varying: so many of the first arguments may be of other sizes, for which the stored code
            serves as well.
        name: key of everything that determines the function, apart from this package's sources and
            ``example``. The result is stored under it next to Inductor's cache, and other processes
            load it without tracing, or wait for it. None stores nothing.
        waits: for another process that compiles the same; otherwise None is returned then.
        **patches: Inductor settings.

    Raises:
        ChildProcessError: if the compiler fails.
    """
    device = example[0].device
    if find_compiler_problem(device.type):
        return function
    with set_up_inductor(device, patches) as folder:
        if name is None:
            return _compile(function, example, num_varying)
        path = folder / f"{_make_name(name, example, num_varying)}.bin"
        with _locked(path, waits=waits) as is_ours:
            if not is_ours:
                return None
            if (compiled := _load(path)) is None:
                compiled = _compile(function, example, num_varying)
                _save(path, compiled)
            return compiled


def is_stored(
    example: Sequence[Tensor], *, name: str, num_varying: int = 0, **patches: object
) -> bool:
    """Return whether ``compile_inplace`` has nothing to make, or finds it on the disk."""
    if find_compiler_problem(example[0].device.type):
        return True
    with set_up_inductor(example[0].device, patches) as folder:
        return (folder / f"{_make_name(name, example, num_varying)}.bin").exists()


@contextmanager
def _locked(path: Path, *, waits: bool) -> Iterator[bool]:
    """Keep other processes from making what belongs at ``path``; False if one does, and no wait."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = path.with_suffix(".lock").open("a")
    except OSError:  # a folder that cannot be written: ``_save`` says so
        yield True
        return
    with lock:
        yield take_lock(lock, waits=waits)


@without_collector()
def compile_differentiable(
    function: Callable[..., Sequence[Tensor]], example: Sequence[Tensor]
) -> Callable[..., Sequence[Tensor]]:
    """Compile ``function(*tensors)``, which changes none, and its gradient with respect to all.

    Inductor's cache keeps the code; itself without a compiler. As for ``compile_inplace``, nothing
    checks later that arguments have shapes, types and the contiguous layout of ``example``. There
    is no forward-mode derivative.

    Raises:
        ChildProcessError: if the compiler fails.
    """
    from torch._inductor.compile_fx import compile_fx

    device = example[0].device
    if find_compiler_problem(device.type):
        return function
    twins = [t.detach().clone() for t in example]
    settings = {"force_non_lazy_backward_lowering": True, "donated_buffer": False}
    eager = torch._functorch.config.patch(settings)
    graph = _trace(function, twins)
    with set_up_inductor(device, {}), eager, torch.enable_grad():
        twins = [t.requires_grad_(t.is_floating_point()) for t in twins]
        compiled = _make_whole(lambda: compile_fx(graph, twins))
        for result in compiled(*twins):  # for retain_graph, torch wants to see that none is donated
            if whole := getattr(result.grad_fn, "_forward_cls", None):
                whole.metadata.bw_donated_idxs = []
        return cast("InPlaceFunction", compiled)


def _compile(
    function: InPlaceFunction, example: Sequence[Tensor], num_varying: int
) -> InPlaceFunction:
    from torch._guards import TracingContext, tracing
    from torch._inductor import standalone_compile
    from torch._subclasses import FakeTensorMode
    from torch.fx.experimental.symbolic_shapes import ShapeEnv

    twins = [_make_twin(t) for t in example]
    mode = FakeTensorMode(shape_env=ShapeEnv())
    options: Any = {"dynamic_shapes": "from_tracing_context", "aot": True}
    # the context remembers them: the function is traced with the same
    stand_ins = [mode.from_tensor(t, static_shapes=i >= num_varying) for i, t in enumerate(twins)]
    with tracing(TracingContext(mode)):
        graph = _trace(function, twins, "symbolic")
        compiled = _make_whole(lambda: standalone_compile(graph, [*stand_ins], **options))
    return cast("InPlaceFunction", compiled)


def _make_twin(t: Tensor) -> Tensor:
    """Return a tensor of the same shape and strides with storage of its own.

    It starts one element into its storage: on a GPU, Inductor would clone arguments that are less
    aligned than the example, and the views of odd steps are.
    """
    size = 1 + sum((n - 1) * s for n, s in zip(t.shape, t.stride(), strict=True))
    store = torch.zeros(size + 1, dtype=t.dtype, device=t.device)
    return store.as_strided(t.shape, t.stride(), 1).copy_(t)


def _trace(
    function: InPlaceFunction, example: Sequence[Tensor], mode: Literal["real", "symbolic"] = "real"
) -> torch.fx.GraphModule:
    from torch.fx.experimental.proxy_tensor import make_fx

    return make_fx(function, tracing_mode=mode)(*example)


def _make_whole(make: Callable[[], Any]) -> Any:
    """Call Inductor; say in one line what the C++ compiler said if it fails.

    A library that a killed compiler left unfinished is deleted and made again.
    """
    from torch._inductor.codecache import CppPythonBindingsCodeCache

    while True:
        try:
            return make()
        except RuntimeError as error:
            damaged = re.search(r"ImportError: (\S+\.so): ", str(error))
            if damaged is None or not Path(damaged[1]).exists():
                said = str(error).rpartition("Output:")[2].strip()
                raise ChildProcessError(
                    f"the compiler failed: {said.partition(chr(10))[0]}"
                ) from error
            logger.warning("%s is damaged: compiling again", damaged[1])
            Path(damaged[1]).unlink()
            CppPythonBindingsCodeCache.cache_clear()


def _make_name(name: str, example: Sequence[Tensor], num_varying: int) -> str:
    """Return a key of what code for one kind of machine depends on: source, settings, arguments."""
    settings = torch._inductor.config.save_config_portable(ignore_private_configs=False)
    return make_key(name, hash_sources(), _describe(example, num_varying), settings)


def _describe(example: Sequence[Tensor], num_varying: int) -> list[object]:
    """Return what code depends on of its arguments: shapes, strides and types.

    Of the first ``num_varying`` only which sizes and strides are equal, and which of a tensor's are
    larger: of these the compiler may make use. Those up to 16 count as they are.
    """
    sizes = [(*t.shape, *t.stride()) for t in example]
    varying = dict.fromkeys(chain(*sizes[:num_varying]))
    names = {size: f"size {i}" for i, size in enumerate(varying) if size > 16}
    described: list[object] = []
    for own, t in zip(sizes, example, strict=True):
        is_varying = len(described) < num_varying
        order = sorted(range(len(own)), key=own.__getitem__)
        form = ([names.get(size, size) for size in own], order) if is_varying else own
        described.append((form, t.dtype))
    return described


def _load(path: Path) -> InPlaceFunction | None:
    """Return what is kept at ``path``, if its checksum is right and it can be used, else None."""
    if not path.exists():
        return None
    try:
        read, content = pickle.loads(gzip.decompress(path.read_bytes()))
        return cast("InPlaceFunction", read(content))
    except Exception as error:  # noqa: BLE001  # any damage: compile again
        logger.warning("%s cannot be used (%s): compiling again", path, error)
        return None


def _save(path: Path, compiled: Any) -> None:
    """Keep compiled code, and what reads it; readers see all of it or nothing."""
    try:
        kept = pickle.dumps((type(compiled).deserialize, compiled.serialize()))
        with staged(path) as part:
            part.write_bytes(gzip.compress(kept, compresslevel=1))
    except TypeError:  # of Inductor, which made nothing that could be stored
        logger.info("Inductor's caches are off: the flow step is compiled at every start")
    except Exception as error:  # noqa: BLE001  # the code itself runs
        logger.warning("the compiled step cannot be kept (%s): it is compiled every time", error)
