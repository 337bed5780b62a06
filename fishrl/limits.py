"""Limits that control groups set for a container or a job."""

import os
from collections.abc import Iterator
from math import ceil, inf
from pathlib import Path

#: Control groups under Linux, and the list of this process's.
ROOT, OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def count_cores() -> int:
    """Return how many cores this process may use, as ``taskset``, a cluster or a container says."""
    given = getattr(os, "sched_getaffinity", None)  # Linux
    cores = len(given(0)) if given else os.cpu_count() or 1
    shares = [
        *(words for words in _read("cpu", "cpu.max") if len(words) == 2),
        *map(list.__add__, _read("cpu", "cpu.cfs_quota_us"), _read("cpu", "cpu.cfs_period_us")),
    ]
    quotas = [int(quota) / int(period) for quota, period in shares if quota.isdigit()]
    return min(cores, *(max(1, ceil(quota)) for quota in quotas)) if quotas else cores


def measure_machine_memory() -> float:
    """Return the bytes of memory that this process may use."""
    look = getattr(os, "sysconf", None)  # not on Windows
    total = look("SC_PAGE_SIZE") * look("SC_PHYS_PAGES") if look else inf
    limits = [*_read("memory", "memory.max"), *_read("memory", "memory.limit_in_bytes")]
    return min([total, *(int(size) if size.isdigit() else inf for (size,) in limits)])


def _read(controller: str, name: str) -> Iterator[list[str]]:
    """Read a file of the groups of this process and of those around them, in versions 1 and 2."""
    for line in OWN.read_text().splitlines() if OWN.is_file() else ():
        _, kinds, path = line.split(":", 2)
        if kinds and controller not in kinds.split(","):
            continue
        top = ROOT / controller if kinds else ROOT
        for folder in (top / path.strip("/"), *(top / path.strip("/")).parents):
            if folder.is_relative_to(top) and (folder / name).is_file():
                yield (folder / name).read_text().split()
