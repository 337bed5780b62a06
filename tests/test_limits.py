"""Limits of control groups and of the machine."""

import os
from pathlib import Path

import pytest

from fishrl import limits

MACHINE = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def quota(value: int) -> dict[str, str]:
    return {"cpu/cpu.cfs_quota_us": str(value), "cpu/cpu.cfs_period_us": "100000"}


@pytest.mark.parametrize(
    ("own", "files", "limits_found"),
    [
        ("0::/\n", {}, (MACHINE, 8)),
        ("0::/\n", {"memory.max": "max", "cpu.max": "max 100000"}, (MACHINE, 8)),
        ("0::/\n", {"memory.max": "1000000", "cpu.max": "150000 100000"}, (1e6, 2)),
        ("0::/a/b\n", {"a/memory.max": "2000", "a/b/memory.max": "max"}, (2000, 8)),
        ("0::/a/b\n", {"a/cpu.max": "max 100000", "a/b/cpu.max": "10000 100000"}, (MACHINE, 1)),
        ("4:memory:/job\n", {"memory/job/memory.limit_in_bytes": "3000"}, (3000, 8)),
        ("4:memory:/gone\n", {"memory/memory.limit_in_bytes": "9" * 19}, (MACHINE, 8)),
        ("1:cpu,cpuacct:/\n0::/\n", quota(400000), (MACHINE, 4)),
        ("1:cpu:/\n", quota(-1), (MACHINE, 8)),
    ],
)
def test_smallest_limit_applies(
    own: str,
    files: dict[str, str],
    limits_found: tuple[float, int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, text in {"own": own, **files}.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n" if name != "own" else text)
    monkeypatch.setattr(limits, "ROOT", tmp_path)
    monkeypatch.setattr(limits, "OWN", tmp_path / "own")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert (limits.measure_machine_memory(), limits.count_cores()) == limits_found
