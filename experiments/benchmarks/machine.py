"""Description of the machine on which measurements were made."""

import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import psutil
import torch

from fishrl.limits import count_cores

PACKAGES = ("torchrl", "tensordict", "numpy")


def describe_machine() -> dict[str, Any]:
    """Return processor, caches, GPU, versions and load average."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": (models or [platform.processor() or platform.machine()])[0],
        "cores": count_cores(),
        "torch": torch.__version__,
        "python": platform.python_version(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "caches": read_caches(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "versions": {name: version(name) for name in PACKAGES},
        "load": round(psutil.getloadavg()[0], 2),
    }


def read_caches(folder: Path = Path("/sys/devices/system/cpu/cpu0/cache")) -> dict[str, int]:
    """Return the bytes of each data cache of the first core by level (Linux only)."""
    sizes = {}
    for entry in sorted(folder.glob("index*")):
        kind, level, size = ((entry / n).read_text().strip() for n in ("type", "level", "size"))
        if kind != "Instruction":
            sizes[f"L{level}"] = int(size.rstrip("K")) * 1024
    return sizes
