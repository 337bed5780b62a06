"""Train for hours with the live view on: ``python -m tests.campaigns.live hours=2``.

Starts ``fishrl train live=true``, with any settings (``training=["preset=gait_paper"]``), and
prints memory, open files and shared memory of the training, its flow workers and the viewer's
server, and the speed of the flows. After the hours it ends the training by SIGTERM: the training
must save, exit with status 143 and leave no process and no shared memory behind; ``resume=`` goes
on with it. Compare the speed of the first and the last rows on a machine that does nothing else.
"""

from __future__ import annotations

import csv
import os
import re
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

from pydantic import Field, PositiveFloat

from fishrl.programs.program import program
from fishrl.settings import Settings


class LiveSettings(Settings):
    """Settings of the campaign.

    Args:
        hours: after which the training is ended.
        rows: of the table.
        folder: in which the run folder is made.
        training: settings of the training, or ``resume=<run folder>``.
    """

    hours: PositiveFloat = 2.0
    rows: Annotated[int, Field(ge=2)] = 24
    folder: str = "runs"
    training: tuple[str, ...] = ("total_frames=1000000",)


def list_family(pid: int) -> list[int]:
    """Return a process and all that descend from it."""
    family = [pid]
    for member in family:
        for task in Path(f"/proc/{member}/task").glob("*/children"):
            family += map(int, task.read_text().split())
    return family


def measure(pid: int) -> dict[str, float]:
    """Return what must not grow; the viewer's server keeps frames up to a limit of its own."""
    memory = {"memory_mb": 0.0, "server_mb": 0.0}
    files = 0
    for member in list_family(pid):
        is_server = "rerun" in os.path.basename(os.readlink(f"/proc/{member}/exe"))
        text = Path(f"/proc/{member}/smaps_rollup").read_text()
        pages = re.findall(r"^(?:Pss_Anon|Pss_Shmem): +(\d+)", text, re.MULTILINE)
        memory["server_mb" if is_server else "memory_mb"] += sum(map(int, pages)) / 1e3
        files += 0 if is_server else len(os.listdir(f"/proc/{member}/fd"))
    return memory | {"files": files, "shm_mb": measure_shared()}


def measure_shared() -> float:
    """Return the size of the flows' memory that has a name in ``/dev/shm``, in MB."""
    return sum(path.stat().st_size for path in Path("/dev/shm").glob("fishrl*")) / 1e6


def read_speeds(metrics: Path) -> list[float]:
    """Return frames per second of each row of metrics."""
    if not metrics.is_file():
        return []
    with metrics.open(newline="") as file:
        return [float(row["time/frames_per_second"] or "nan") for row in csv.DictReader(file)]


@program(LiveSettings)
def main(settings: LiveSettings) -> None:
    """Train, print rows, end the training and look at what it leaves."""
    words = ["live=true", f"folder={settings.folder}", "name=live", *settings.training]
    resumed = [word.partition("=")[2] for word in words if word.startswith("resume=")]
    run = Path(resumed[0] if resumed else f"{settings.folder}/live")
    words = ["live=true", *settings.training] if resumed else words
    training = subprocess.Popen([sys.executable, "-m", "fishrl", "train", *words])
    began, seen = time.monotonic(), len(read_speeds(run / "metrics.csv"))
    for row in range(1, settings.rows + 1):
        wait = began + 3600 * settings.hours * row / settings.rows - time.monotonic()
        try:
            sys.exit(f"the training ended early, with status {training.wait(max(0.0, wait))}")
        except subprocess.TimeoutExpired:
            values = measure(training.pid)
        speeds = read_speeds(run / "metrics.csv")
        seen, new = len(speeds), speeds[seen:]
        values["frames_per_s"] = statistics.median(new) if new else float("nan")
        shown = "  ".join(f"{name} {value:.6g}" for name, value in values.items())
        print(f"\n{(time.monotonic() - began) / 3600:6.2f} h  {seen} rows  {shown}", flush=True)
    family = list_family(training.pid)
    training.send_signal(signal.SIGTERM)
    status = training.wait(600)
    time.sleep(5)
    left = [pid for pid in family if Path(f"/proc/{pid}").exists()]
    if status != 143 or left or measure_shared():
        sys.exit(f"status {status}, processes left: {left}, shared memory: {measure_shared()} MB")
    print(f"ended with status {status}; no process and no shared memory is left")


if __name__ == "__main__":
    main()
