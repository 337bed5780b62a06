"""What it costs to hold the station without a half disc: ``python -m experiments.free_stream``.

In streams of the same speeds a hand-written fish (PID on its distance, any frequency) holds its
place without an obstacle. It must beat several times faster than in a wake, so that steps per T
follow from the Mach budget of that beat. The work per T is taken from the second half of the
episodes, in which it holds. Histories are kept; what was swum before is not swum again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from experiments.command_line import plain_errors, set_up_logging
from experiments.gait import tables
from experiments.gait.diagnostics import measure_lean, pick, trace_work
from experiments.gait.histories import Histories
from experiments.gait.trials import Trial, run_trial
from experiments.statistics import half_width
from experiments.transfer import load_task, split_flows
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.modules import PID
from fishrl.training.baselines import make_gait_policy
from fishrl.training.progress import Progress
from fishrl.training.recognition import Recognition


def make_trial(
    *,
    preset: str,
    max_frequency: float,
    num_frequencies: int,
    frequency: float,
    max_wall_speed: float,
    periods: float,
) -> Trial:
    """Return the fish: it may beat at any of ``num_frequencies`` up to ``max_frequency`` per T."""
    steps = num_frequencies - 1
    frequencies = tuple(max_frequency * step / steps for step in range(num_frequencies))
    task = replace(load_task(preset), max_wall_speed=max_wall_speed)
    checks = ceil(task.checks_per_action * max_frequency / task.control.max_frequency)
    task = replace(
        task,
        checks_per_action=max(task.checks_per_action, checks),  # T has so many more steps
        stream=replace(task.stream, has_disc=False),
        control=DirectFrequencies(frequencies=frequencies, first_gear=0),
        # from rest it is swept back until it swims
        safe_area=replace(task.safe_area, far_bl=6.0),
    )
    dt = task.interval_T  # sum and change are per decision
    controller = PID(
        frequency=frequency, gain=3.0, integral_gain=0.15 * dt, damping=4.0 / dt, max_sum=20.0 / dt
    )
    return Trial(
        name="free-stream",
        arm="free stream",
        recognition=Recognition(task, None),
        make_policy=lambda: make_gait_policy(controller, task),
        identity=f"PID {vars(controller)}",
        periods=periods,
    )


def summarise(
    flows: Sequence[Histories], *, periods: float, interval_T: float = 1.0
) -> list[dict[str, float]]:
    """Return work per T, frequency and remaining drift in the second half, for each flow.

    Args:
        flows: episodes in each.
        periods: T that a fish had to hold; those that did not are left out, and counted.
        interval_T: duration of an action in T.

    Raises:
        ValueError: if in some flow no fish held.
    """
    rows = []
    for number, everything in enumerate(flows):
        holds = _holds(everything, periods)
        if not holds.any():
            raise ValueError(
                f"flow {number}: no fish held its station for {periods} T; raise --max-frequency "
                "or --frequency"
            )
        histories = pick(everything, holds)
        half = histories.frequency.shape[1] // 2
        time_T = interval_T * (histories.frequency.shape[1] - half)
        row: dict[str, float] = {"episodes": len(holds), "held": int(holds.sum())}
        for name in ("work", "positive_work", "lateral_work"):
            series = getattr(histories, name)
            per_T = (series[:, -1] - series[:, half]) / time_T
            row[name] = float(per_T.mean())
            row[f"{name}_error"] = half_width(per_T.tolist())
        row["frequency"] = float(histories.frequency[:, half:].mean())
        drift = histories.place[:, -1, 0] - histories.place[:, half, 0]
        row["drift"] = float(drift.mean()) / time_T
        _, leans = measure_lean(histories, interval_T=interval_T)
        row["lean"] = float(leans.mean())
        rows.append(row)
    return rows


def _holds(flow: Histories, periods: float) -> Tensor:
    return flow.lengths_T >= periods - 1e-6


def main() -> None:
    """Swim, write, compare with a transfer test if there is one."""
    parser = argparse.ArgumentParser(description="Work of holding station in a free stream.")
    parser.add_argument("--preset", default="gait_small")
    parser.add_argument("--episodes", type=int, default=4, help="in each flow")
    parser.add_argument("--periods", type=int, default=30, help="T that each swims")
    parser.add_argument("--max-frequency", type=float, default=10.0, help="beats per T")
    parser.add_argument(
        "--max-wall-speed",
        type=float,
        default=0.1,
        help="so fast a tail diverges at the wake's 0.15",
    )
    parser.add_argument("--frequency", type=float, default=5.0, help="of the controller at rest")
    parser.add_argument("--wake", type=Path, default=Path("runs/transfer"), help="transfer test")
    parser.add_argument("--arm", default="both modules", help="its fish to compare with")
    parser.add_argument("--folder", type=Path, default=Path("runs/free_stream"))
    arguments = parser.parse_args()
    set_up_logging()
    with plain_errors(), Progress() as progress:
        trial = make_trial(
            preset=arguments.preset,
            max_frequency=arguments.max_frequency,
            num_frequencies=81,
            frequency=arguments.frequency,
            max_wall_speed=arguments.max_wall_speed,
            periods=arguments.periods,
        )
        histories = run_trial(
            trial,
            episodes=arguments.episodes,
            folder=arguments.folder / "histories",
            progress=progress,
        )
    task = trial.task
    speeds = task.stream.speeds_bl
    periods = task.time_limit * task.interval_T
    with plain_errors():
        flows = split_flows(histories, len(speeds))
        rows = summarise(
            flows,
            periods=periods,
            interval_T=task.interval_T,
        )
    scales = task.scales
    result: dict[str, Any] = {
        "speeds_bl": list(speeds),
        "steps_per_T": scales.period,
        "mach": scales.mach,
        "tau": scales.tau,
        "flows": rows,
        "work": [
            trace_work(pick(flow, _holds(flow, periods)), interval_T=task.interval_T)
            for flow in flows
        ],
    }
    folder: Path = arguments.folder
    (folder / "free_stream.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    for speed, row in zip(speeds, rows, strict=True):
        print(
            f"{speed:g} L/T: {row['frequency']:.2f} beats per T, work {row['work']:.2f} ± "
            f"{row['work_error']:.2f} per T, drift {row['drift']:+.3f} L/T, held "
            f"{row['held']:.0f} of {row['episodes']:.0f}"
        )
    in_wake = arguments.wake / "transfer.json"
    if in_wake.is_file():
        wake = json.loads(in_wake.read_text(encoding="utf-8"))["arms"].get(arguments.arm)
        if wake is not None:
            table = tables.write_work_table(wake, rows, speeds)
            (folder / "work.md").write_text(table, encoding="utf-8")
            print("\n" + table)
    print(f"written to {folder}")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
