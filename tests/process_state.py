"""What a process holds for all of its code, which a call must leave as it was."""

import gc
import locale
import logging
import os
import random
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium  # noqa: F401 - imported later, these would add filters of warnings and variables
import matplotlib as mpl
import numpy as np
import scipy.sparse
import scipy.special  # noqa: F401
import torch


def read_process_state() -> dict[str, Any]:
    """Return generators, filters, switches, handlers, levels and variables, by name."""
    tiny = torch.tensor(1e-310, dtype=torch.float64)
    loggers = [
        logging.getLogger(),
        *map(logging.getLogger, sorted(logging.root.manager.loggerDict)),
    ]
    mask = os.umask(0)
    os.umask(mask)
    return {
        "random": hash(random.getstate()),
        "numpy.random": str(np.random.get_state()),  # noqa: NPY002
        "torch generator": torch.get_rng_state().tolist(),
        "cuda generators": [one.tolist() for one in torch.cuda.get_rng_state_all()],
        "warnings": [str(entry) for entry in warnings.filters if _is_ours(entry[2])],
        "flushes denormals": float(tiny * 0.5) == 0.0,
        "numpy errors": np.geterr(),
        "default dtype": torch.get_default_dtype(),
        "default device": torch.get_default_device(),
        "threads": torch.get_num_threads(),
        "gradients": (torch.is_grad_enabled(), torch.is_inference_mode_enabled()),
        "autocast": torch.is_autocast_enabled("cpu"),
        "determinism": torch.are_deterministic_algorithms_enabled(),
        "matmul precision": torch.get_float32_matmul_precision(),
        "environment": dict(os.environ),
        "signals": {n: signal.getsignal(n) for n in signal.valid_signals()},
        "logging": {x.name: (x.level, x.disabled, tuple(x.handlers)) for x in loggers},
        "excepthook": (sys.excepthook, threading.excepthook, sys.displayhook),
        "profiler": (sys.getprofile(), sys.gettrace()),
        "folder": os.getcwd(),
        "arguments": list(sys.argv),
        "path": list(sys.path),
        "streams": (sys.stdout, sys.stderr),
        "recursion": sys.getrecursionlimit(),
        "gc": (gc.isenabled(), gc.get_threshold()),
        "umask": mask,
        "locale": locale.setlocale(locale.LC_ALL),
        "matplotlib": str(mpl.rcParams),
    }


def _is_ours(category: type) -> bool:
    """Return whether a filter is not what a library adds for itself as it is imported."""
    return category.__module__.partition(".")[0] in ("builtins", "fishrl", "torch")


@contextmanager
def leaving_process_as_it_was() -> Iterator[None]:
    """Fail if the block changes the process; new loggers with nothing set may appear."""
    before = read_process_state()
    yield
    after = read_process_state()
    quiet = (logging.NOTSET, False, ())
    after["logging"] = {
        name: of
        for name, of in after["logging"].items()
        if name in before["logging"] or of != quiet
    }
    changed = {
        name: _show_change(before[name], after[name])
        for name in before
        if before[name] != after[name]
    }
    assert not changed, f"left changed: {changed}"


def _show_change(before: Any, after: Any) -> Any:
    if isinstance(before, dict) and isinstance(after, dict):
        names = [n for n in {**before, **after} if before.get(n) != after.get(n)]
        return {n: (before.get(n), after.get(n)) for n in names}
    return str(before)[:80], str(after)[:80]
