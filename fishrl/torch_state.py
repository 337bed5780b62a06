"""Independence of torch's global state: what a caller has set there changes no flow."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

import torch

T = TypeVar("T")
P = ParamSpec("P")
_DENORMAL = 2.0**-1040


@contextmanager
def own_torch_state(*, is_learning: bool = False) -> Iterator[None]:
    """Run a block with the defaults float32 and CPU, without autocast, outside inference mode.

    Denormals, into which still water decays, and which are slow, are flushed to zero. Gradients are
    recorded only if ``is_learning``. The caller's state is restored afterwards.
    """
    before = torch.get_default_dtype()
    with ExitStack() as stack:
        if not _flushes_denormals():
            stack.callback(torch.set_flush_denormal, False)
            torch.set_flush_denormal(True)
        stack.callback(torch.set_default_dtype, before)
        torch.set_default_dtype(torch.float32)
        stack.enter_context(torch.inference_mode(False))
        stack.enter_context(torch.set_grad_enabled(is_learning))
        for kind in ("cpu", "cuda"):
            if torch.is_autocast_enabled(kind):
                stack.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            stack.enter_context(torch.device("cpu"))
        yield


def _is_own_torch_state(*, is_learning: bool) -> bool:
    """Return whether ``own_torch_state`` would change nothing."""
    return (
        torch.is_grad_enabled() is is_learning
        and not torch.is_inference_mode_enabled()
        and torch.get_default_dtype() == torch.float32
        and not (torch.is_autocast_enabled("cpu") or torch.is_autocast_enabled("cuda"))
        and _flushes_denormals()
        and torch.get_default_device().type == "cpu"
    )


def _flushes_denormals() -> bool:
    return _DENORMAL + _DENORMAL == 0.0  # Python's numbers follow the processor's switch, too


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one CPU thread: small networks and single flows gain nothing from more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_own_state(function: Callable[P, T], *, is_learning: bool = False) -> Callable[P, T]:
    """Decorate a function with ``own_torch_state``."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        if _is_own_torch_state(is_learning=is_learning):
            return function(*args, **kwargs)
        with own_torch_state(is_learning=is_learning):
            return function(*args, **kwargs)

    return run


def with_own_state(kind: type[T], *, is_learning: bool = False) -> type[T]:
    """Decorate the constructor and the public methods of a class by ``in_own_state``."""
    for name, method in list(vars(kind).items()):
        if callable(method) and (name == "__init__" or not name.startswith("_")):
            setattr(kind, name, in_own_state(method, is_learning=is_learning))
    return kind
