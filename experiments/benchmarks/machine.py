"""What the figures were measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch

PACKAGES = ("torchrl", "tensordict", "numpy", "lbmpy", "pystencils", "numba", "lettucecfd", "xlb")

_CACHE_FILES = ("type", "level", "size")


def describe_machine() -> dict[str, object]:
    """Name what the figures were measured on."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = lines[0].split(":", 1)[1].strip() if lines else model
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "python": platform.python_version(),
    }


def describe_surroundings() -> dict[str, object]:
    """Name what else speed depends on: vector instructions, caches, GPU, versions, other load."""
    installed = {}
    for name in PACKAGES:
        try:
            installed[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "caches": read_caches(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "versions": installed,
        "load": round(os.getloadavg()[0], 2),
    }


def read_caches(folder: Path = Path("/sys/devices/system/cpu/cpu0/cache")) -> dict[str, int]:
    """Return the bytes of each data cache that the first core sees, by level, such as L2.

    Args:
        folder: where Linux lists them; nothing is returned where there is none.
    """
    sizes = {}
    for entry in sorted(folder.glob("index*")):
        kind, level, size = ((entry / name).read_text().strip() for name in _CACHE_FILES)
        if kind != "Instruction":
            sizes[f"L{level}"] = int(size.rstrip("K")) * 1024
    return sizes
