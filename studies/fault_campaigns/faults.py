"""Kill trainings at random moments and compare: ``python -m tests.campaigns.faults kills=50``.

A small training is ended by SIGKILL again and again, and resumed each time, until it is finished;
then the next one begins, until there were enough kills. Each must have written the metrics, bit
for bit, and the result of a training that nobody disturbed, but for the columns of time.
"""

from __future__ import annotations

import csv
import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from pydantic import Field, NonNegativeInt, PositiveInt

from fishrl.programs.program import program
from fishrl.settings import Settings

#: A fish of 16 nodes in a tank of 80 x 48, evaluated and saved every few decisions.
TRAINING = [
    *("compile=false", "num_envs=2", "warmup_frames=8", "updates_per_frame=1", "batch_size=8"),
    *("hidden=[16]", "log_frames=2", "checkpoint_frames=4", "eval_frames=16", "eval_episodes=1"),
    *("final_episodes=1", "baselines=[]", "picture_episodes=0", "name=run", "task.time_limit=6"),
    *("task.body_length=16", "task.reynolds=300", "task.max_wall_speed=0.15"),
    *("task.wall_margin_bl=0.3", "task.domain_bl=[5.0,3.0]", "task.start_x_bl=[2.5,3.5]"),
    *("task.food_x_bl=1.0", "task.food_y_bl=1.5", "task.food_limits_bl=[1.0,2.0]"),
    *("task.control_interval_T=0.25", "task.checks_per_action=4"),
]


class FaultSettings(Settings):
    """Settings of the campaign.

    Args:
        kills: how often a training is killed.
        frames: of each training.
        seed: of the moments.
    """

    kills: PositiveInt = 50
    frames: Annotated[int, Field(ge=2)] = 96
    seed: NonNegativeInt = 0


def start(folder: Path, frames: int) -> subprocess.Popen[bytes]:
    """Start a training in a folder, or go on with the one in it."""
    words = [*TRAINING, f"total_frames={frames}", f"folder={folder}"]
    if (folder / "run" / "config.yaml").is_file():
        words = [f"resume={folder / 'run'}"]
    with (folder / "log").open("ab") as log:
        command = [sys.executable, "-m", "fishrl", "train", *words]
        return subprocess.Popen(command, stdout=log, stderr=log)


def read(folder: Path) -> tuple[list[dict[str, str]], dict[str, object]]:
    """Return metrics and summary of a training without its times."""
    run = folder / "run"
    with (run / "metrics.csv").open(newline="") as file:
        rows = [{k: v for k, v in r.items() if "time/" not in k} for r in csv.DictReader(file)]
    summary = json.loads((run / "summary.json").read_text())
    return rows, {k: v for k, v in summary.items() if k not in ("wall_seconds", "mlups")}


@program(FaultSettings)
def main(settings: FaultSettings) -> None:
    """Run the undisturbed training, kill the others, compare and count."""
    draw, kills, trainings, moments = random.Random(settings.seed), 0, 0, []
    with TemporaryDirectory(prefix="faults-") as place:
        folders = [Path(place) / "undisturbed"]
        folders[0].mkdir()
        began = time.perf_counter()
        if start(folders[0], settings.frames).wait():
            sys.exit((folders[0] / "log").read_text())
        seconds = time.perf_counter() - began
        wanted = read(folders[0])
        while kills < settings.kills:
            folder = Path(place) / f"{trainings}"
            folder.mkdir()
            is_whole = True
            while not (folder / "run" / "summary.json").is_file():
                process, began = start(folder, settings.frames), time.perf_counter()
                try:
                    wait = draw.uniform(0.1, 1.1) * seconds if kills < settings.kills else None
                    if process.wait(wait):
                        sys.exit((folder / "log").read_text())
                    if is_whole:  # the machine may be faster or slower than before
                        seconds = time.perf_counter() - began
                except subprocess.TimeoutExpired:
                    is_whole = False
                    process.send_signal(signal.SIGKILL)
                    process.wait()
                    kills, metrics = kills + 1, folder / "run" / "metrics.csv"
                    rows = metrics.read_text().count("\n") if metrics.is_file() else 0
                    moments.append(rows)
                    print(f"kill {kills} at row {rows} of training {trainings}", flush=True)
            if read(folder) != wanted:
                sys.exit(f"training {trainings} differs from the undisturbed one")
            trainings += 1
    before = sum(rows < 2 for rows in moments)
    print(
        f"{kills} kills ({before} before the first row of metrics) in {trainings} trainings: all "
        f"equal to the undisturbed one, {len(wanted[0])} rows bit for bit"
    )


if __name__ == "__main__":
    main()
