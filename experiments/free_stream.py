"""Measure the work of holding station without a half disc: ``python -m experiments.free_stream``.

In free streams of the same speeds, PID control of the distance with any frequency holds a station.
It beats several times faster than in a wake, so the steps per T follow from the Mach number of that
beat. The work per T is that of the second half of the episodes. Histories are cached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

import torch

from fishrl.bounds import bounded
from fishrl.envs import KarmanGait
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.modules import PID
from fishrl.programs.gait import trials
from fishrl.programs.gait.diagnostics import WORKS, measure_lean, trace_work
from fishrl.programs.program import TaskSettings, program
from fishrl.programs.statistics import half_width
from fishrl.training.baselines import make_gait_policy
from fishrl.training.description import make
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

_NUM_FREQUENCIES = 81


@dataclass(frozen=True, kw_only=True)
class FreeStreamSettings(TaskSettings):
    """Settings of a free-stream test.

    Args:
        episodes: episodes in each flow.
        periods: duration of an episode in T.
        max_frequency: largest frequency that may be commanded, beats per T.
        max_wall_speed: speed of the tail, nodes per step; at that of the wake the flow diverges.
        frequency: frequency of the controller at zero error, beats per T.
        folder: folder for results and histories.
    """

    episodes: int = bounded(4, least=1)
    periods: int = bounded(30, least=1)
    max_frequency: float = bounded(10.0, greater=0)
    max_wall_speed: float = bounded(0.1, greater=0)
    frequency: float = bounded(5.0, least=0)
    folder: str = "runs/free_stream"


def make_free_trial(task: KarmanGait, settings: FreeStreamSettings) -> trials.Trial:
    """Return the trial of a PID controller in the streams of a task without their disc."""
    task = replace(task, max_wall_speed=settings.max_wall_speed)
    steps = _NUM_FREQUENCIES - 1
    row = tuple(settings.max_frequency * step / steps for step in range(_NUM_FREQUENCIES))
    checks = ceil(task.checks_per_action * settings.max_frequency / task.control.max_frequency)
    task = replace(
        task,
        checks_per_action=max(task.checks_per_action, checks),  # T has so many more steps
        stream=replace(task.stream, has_disc=False),
        control=DirectFrequencies(frequencies=row, first_gear=0),
        # from rest it is swept back until it swims
        safe_area=replace(task.safe_area, far_bl=6.0),
    )
    dt = task.interval_T  # sum and change are per decision
    controller = PID(
        frequency=settings.frequency,
        gain=3.0,
        integral_gain=0.15 * dt,
        damping=4.0 / dt,
        max_sum=20.0 / dt,
    )
    return trials.Trial(
        name="free-stream",
        arm="free stream",
        task=trials.prolong(task, settings.periods),
        make_policy=lambda: make_gait_policy(controller, task),
        identity=f"PID {vars(controller)}",
    )


def summarise(held: trials.Histories, *, interval_T: float) -> dict[str, float]:
    """Return work per T, frequency and remaining drift in the second half of episodes."""
    num_intervals = held.frequency.shape[1]
    half = num_intervals // 2
    time_T = interval_T * (num_intervals - half)
    row: dict[str, float] = {}
    for name in WORKS:
        series = getattr(held, name)
        per_T = (series[:, -1] - series[:, half]) / time_T
        row |= {name: float(per_T.mean()), f"{name}_error": half_width(per_T.tolist())}
    row["frequency"] = float(held.frequency[:, half:].mean())
    row["drift"] = float((held.place[:, -1, 0] - held.place[:, half, 0]).mean()) / time_T
    row["lean"] = float(measure_lean(held, interval_T=interval_T)[1].mean())
    return row


@program(FreeStreamSettings, groups={"task": "karman_gait", "preset": "gait_small"})
def main(settings: FreeStreamSettings) -> None:
    """Run, write and print."""
    torch.set_num_threads(1)
    s, folder = settings, Path(settings.folder)
    trial = make_free_trial(make(s.task, kind=KarmanGait), s)
    task, rows, work = trial.task, [], []
    scales, speeds, interval_T = task.scales, task.stream.speeds_bl, task.interval_T
    with Progress() as progress:
        flows = trials.run_trial(trial, episodes=s.episodes, folder=folder, progress=progress)
    for speed, flow in zip(speeds, flows, strict=True):
        held = trials.pick(flow, flow.lengths_T >= task.time_limit * interval_T - 1e-6)
        num, num_held = len(flow.flow), len(held.flow)
        if not num_held:
            raise ValueError(f"stream {speed:g} L/T: no episode lasted; raise frequency")
        row = {"episodes": num, "held": num_held} | summarise(held, interval_T=interval_T)
        rows.append(row)
        work.append(trace_work(held, interval_T=interval_T))
        print(
            f"{speed:g} L/T: {row['frequency']:.2f} beats per T, work {row['work']:.2f} ± "
            f"{row['work_error']:.2f} per T, drift {row['drift']:+.3f} L/T, "
            f"held {num_held} of {num}"
        )
    facts = {"steps_per_T": scales.period, "mach": scales.mach, "tau": scales.tau}
    result = {"speeds_bl": list(speeds), **facts, "flows": rows, "work": work}
    write_json(folder / "free_stream.json", result)
    print(f"written to {folder}")


if __name__ == "__main__":
    main()
