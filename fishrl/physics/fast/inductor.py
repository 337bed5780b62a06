"""Inductor, the compiler of torch: its settings here, and what its code depends on of a machine."""

import gc
import logging
import os
import platform
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import torch

from fishrl.physics.cache_key import make_key

logger = logging.getLogger(__name__)


@contextmanager
def without_collector() -> Iterator[None]:
    """Suspend the garbage collector: a tenth of the compiler's time, and it frees little."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@cache
@without_collector()
def find_compiler_problem(device_type: str) -> str | None:
    """Return why nothing can be compiled for ``device_type``, or None; logged once."""
    problem = _find_cpp_problem() if device_type == "cpu" else None
    if problem:
        logger.warning("%s: the flow runs eagerly, about 50 times slower", problem)
    return problem


def _find_cpp_problem() -> str | None:
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.runtime.cache_dir_utils import cache_dir, default_cache_dir

    try:
        with torch._inductor.config.patch(_list_settings()):
            compiler = get_cpp_compiler()
    except (RuntimeError, OSError):
        if "CXX" in os.environ:
            return f"CXX={os.environ['CXX']!r} is no C++ compiler: name one program, or unset CXX"
        return "no C++ compiler (g++ or clang++) on the path"
    paths = {  # that Inductor puts into commands without quotes
        "set TORCHINDUCTOR_CACHE_DIR": cache_dir(),
        "set TMPDIR or LOGNAME": default_cache_dir(),
        "set CXX": compiler,
        "install torch elsewhere": torch.__path__[0],
        "install Python elsewhere": sysconfig.get_config_var("LIBDIR") or "",
    }
    for remedy, path in paths.items():
        if set(path) & set(" \t\r\n\"'\\"):
            return f"a space, quote or backslash in the path {path!r} is not supported ({remedy})"
    return None


def _list_settings() -> dict[str, object]:
    """Return Inductor's settings: fused multiply-add, no checks of shapes, which never change."""
    compilers = torch._inductor.config.cpp.cxx  # $CXX alone, or g++
    return {
        "cpp.cxx": compilers if "CXX" in os.environ else (*compilers, "clang++"),
        "cpp.enable_floating_point_contract_flag": "fast",
        "size_asserts": False,
        "alignment_asserts": False,
        "cpp.vec_isa_ok": True,  # by the processor's flags; else a program is compiled for each
        # For networks: frozen constants are not stored, and templates fail on mutated arguments.
        "freezing": False,
        "max_autotune": False,
        "max_autotune_gemm": False,
    }


@cache
def describe_target() -> str:
    """Return the compiler's macros: its version, and what it takes this processor for."""
    from torch._inductor.cpp_builder import get_cpp_compiler

    command = [get_cpp_compiler(), "-march=native", "-dM", "-E", "-xc++", os.devnull]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def identify_machine(device: torch.device) -> str:
    """Return a key of what compiled code depends on, apart from its source and its settings.

    Inductor's own keys lack most of it: the width of vectors, the instructions that
    ``-march=native`` allows, and the versions of compiler and C library.
    """
    from torch._inductor.cpu_vec_isa import pick_vec_isa

    target: list[object] = [torch.__config__.show(), sys.version, platform.libc_ver()]
    if device.type == "cuda":
        target += [torch.cuda.get_device_name(device), device]  # the code holds its index
    else:
        vectors = pick_vec_isa().build_arch_flags()  # for the processor and ATEN_CPU_CAPABILITY
        target += [torch.get_num_threads(), vectors, describe_target()]
    return make_key(target)


@contextmanager
def set_up_inductor(device: torch.device, patches: dict[str, object]) -> Iterator[Path]:
    """Apply settings, and yield a folder for this kind of machine, in which Inductor stores."""
    from torch._inductor import cpu_vec_isa
    from torch._inductor.runtime.cache_dir_utils import cache_dir

    if device.type == "cpu":  # else a warning in each process where there is nvcc but no GPU
        logging.getLogger("torch.utils.cpp_extension").setLevel(logging.ERROR)
    # a search, a tenth of the compilation on a CPU; combined kernels of a GPU fail without it
    search = {"reorder_for_peak_memory": device.type != "cpu"}
    with torch._inductor.config.patch(_list_settings() | search | patches):
        before, list_all = cache_dir(), cpu_vec_isa.valid_vec_isa_list
        if units := _list_vector_units():
            cpu_vec_isa.valid_vec_isa_list = cache(lambda: units)
        try:
            folder = Path(before, "fishrl", identify_machine(device))
            os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(folder)
            yield folder
        finally:
            cpu_vec_isa.valid_vec_isa_list = list_all
            os.environ["TORCHINDUCTOR_CACHE_DIR"] = before


@cache
def _list_vector_units() -> list[Any]:
    """Return the vector units for floats that the processor's flags name; none but of x86.

    Inductor would compile and load a program for each of those for bfloat16 and integers.
    """
    from torch._inductor.cpu_vec_isa import VecAVX2, VecAVX512, x86_isa_checker

    flags = x86_isa_checker()
    units = [
        type(unit.__name__, (unit,), {"__bool__": lambda _: True})()
        for unit in (VecAVX512, VecAVX2)
    ]
    return [unit for unit in units if all(flag in flags for flag in str(unit).split())]
