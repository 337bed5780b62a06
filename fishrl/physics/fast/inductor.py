"""Inductor, the compiler of torch: its settings here, and what its code depends on of a machine."""

import gc
import logging
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import torch

from fishrl.physics.cache_key import make_key

logger = logging.getLogger(__name__)

#: Setting of parts that gather and scatter: vectors of 256 bits where the processor has 512, which
#: takes a fifth off the time of bodies on an Intel Xeon, whose compiler prefers these.
GATHERING: dict[str, object] = {"cpp.simdlen": 256}


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
def find_compiler_problem(device_type: str) -> str | None:
    """Return why nothing can be compiled for ``device_type``, or None; logged once."""
    problem = _find_cpp_problem() if device_type == "cpu" else None
    if problem:
        logger.warning("%s: the flow runs eagerly, about 50 times slower", problem)
    return problem


def _find_cpp_problem() -> str | None:
    compiler = _find_compiler()
    if compiler is None or not describe_target(compiler):
        if "CXX" in os.environ:
            return f"CXX={os.environ['CXX']!r} is no C++ compiler: name one program, or unset CXX"
        return "no C++ compiler (g++ or clang++) on the path"
    paths = {  # that Inductor puts into commands without quotes
        "set TORCHINDUCTOR_CACHE_DIR": str(_find_cache()),
        "set TMPDIR": tempfile.gettempdir(),
        "set CXX": compiler,
        "install torch elsewhere": torch.__path__[0],
        "install Python elsewhere": sysconfig.get_config_var("LIBDIR") or "",
    }
    for remedy, path in paths.items():
        if set(path) & set(" \t\r\n\"'\\"):
            return f"a space, quote or backslash in the path {path!r} is not supported ({remedy})"
    return None


def _find_compiler() -> str | None:
    """Return the path of the C++ compiler: that of ``CXX`` alone, or g++, or clang++."""
    names = [os.environ["CXX"]] if "CXX" in os.environ else ["g++", "clang++"]
    return next(filter(None, map(shutil.which, names)), None)


@cache
def describe_target(compiler: str) -> str:
    """Return the compiler's macros: its version, and what it takes this processor for."""
    for flags in (["-march=native"], []):  # which some compilers do not know
        command = [compiler, *flags, "-dM", "-E", "-xc++", os.devnull]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return done.stdout
    return ""


def _find_cache() -> Path:
    """Return the folder of compiled code: as the environment names it, or one for each user."""
    own = Path(tempfile.gettempdir(), f"torchinductor_{getattr(os, 'getuid', os.getpid)()}")
    return Path(os.environ.get("TORCHINDUCTOR_CACHE_DIR") or own).absolute()


def _list_settings(device: torch.device) -> dict[str, object]:
    """Return Inductor's settings, such as fused multiply-add."""
    return {
        "cpp.cxx": (_find_compiler(),),
        "cpp.enable_floating_point_contract_flag": "fast",
        "alignment_asserts": False,
        "cpp.vec_isa_ok": True,  # by the processor's flags; else a program is compiled for each
        # For networks: frozen constants are not stored, and templates fail on mutated arguments.
        "freezing": False,
        "max_autotune": False,
        "max_autotune_gemm": False,
        # a search, a tenth of the compilation on a CPU; combined kernels of a GPU fail without it
        "reorder_for_peak_memory": device.type != "cpu",
    }


def identify_machine(device: torch.device) -> str:
    """Return a key of what compiled code depends on, apart from its source and its settings.

    Inductor's own keys lack most of it: the width of vectors, the instructions that
    ``-march=native`` allows, and the versions of compiler and C library.
    """
    target: list[object] = [torch.__config__.show(), sys.version, platform.libc_ver()]
    if device.type == "cuda":
        target += [torch.cuda.get_device_name(device), device]  # the code holds its index
    else:
        vectors = os.environ.get("ATEN_CPU_CAPABILITY")
        target += [torch.get_num_threads(), vectors, describe_target(_find_compiler() or "")]
    return make_key(target)


@contextmanager
def set_up_inductor(device: torch.device, patches: dict[str, object]) -> Iterator[Path]:
    """Apply settings, and yield a folder for this kind of machine, in which Inductor stores."""
    from torch._inductor import cpu_vec_isa

    probes = logging.getLogger("torch.utils.cpp_extension")
    level = probes.level
    target = describe_target(_find_compiler() or "")
    if "__AVX2__ " not in target and patches.items() >= GATHERING.items():
        patches = patches | {"cpp.simdlen": None}
    if device.type == "cpu":  # else a warning in each process where there is nvcc but no GPU
        probes.setLevel(logging.ERROR)
    with torch._inductor.config.patch(_list_settings(device) | patches):
        before, list_all = os.environ.get("TORCHINDUCTOR_CACHE_DIR"), cpu_vec_isa.valid_vec_isa_list
        units = [
            _without_probe(unit)
            for unit, macro in (
                (cpu_vec_isa.VecAVX512, "__AVX512DQ__"),
                (cpu_vec_isa.VecAVX2, "__AVX2__"),
            )
            if f"{macro} " in target
        ]
        if units:
            cpu_vec_isa.valid_vec_isa_list = cache(lambda: units)
        try:
            folder = _find_cache() / "fishrl" / identify_machine(device)
            os.environ["TORCHINDUCTOR_CACHE_DIR"] = str(folder)
            yield folder
        finally:
            probes.setLevel(level)
            cpu_vec_isa.valid_vec_isa_list = list_all
            del os.environ["TORCHINDUCTOR_CACHE_DIR"]
            if before is not None:
                os.environ["TORCHINDUCTOR_CACHE_DIR"] = before


@cache
def _without_probe(unit: type) -> Any:
    """Return a vector unit for floats that is taken for there.

    Inductor would compile and load a program for each of those for bfloat16 and integers.
    """
    return type(unit.__name__, (unit,), {"__bool__": lambda _: True})()
