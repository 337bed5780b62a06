"""Work of holding station without a half disc, for comparison with the wake.

In free streams of the same speeds, a PID controller of the distance that may choose any frequency
holds station. The fish beats several times faster than in a wake, and its Mach number sets the
steps per T.
"""

from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any

from experiments.gait.diagnostics import BALANCE, list_works, trace_work
from experiments.gait.trials import Histories, Trial, pick, prolong, run_trial
from fishrl.envs import Flows, KarmanGait
from fishrl.envs.control import DirectFrequencies
from fishrl.modules import PID
from fishrl.programs.statistics import half_width
from fishrl.training.baselines import make_gait_policy
from fishrl.training.callback import SILENT, Callback

#: Longest duration of an episode, T; the work per T is measured in its second half.
MAX_PERIODS = 30.0
#: Frequency of the controller at zero error and largest one, beats per T; number of frequencies.
FREQUENCY, MAX_FREQUENCY, NUM_FREQUENCIES = 5.0, 10.0, 81
#: Speed of the tail, nodes per step; at 0.15, as in the wake, the flow diverges.
MAX_WALL_SPEED = 0.1


def make_free_trial(task: KarmanGait, *, periods: float) -> Trial:
    """Return the trial of a PID controller in the streams of a task without their disc."""
    steps = NUM_FREQUENCIES - 1
    row = tuple(MAX_FREQUENCY * step / steps for step in range(NUM_FREQUENCIES))
    checks = ceil(task.checks_per_action * MAX_FREQUENCY / task.control.max_frequency)
    free = replace(
        task,
        max_wall_speed=MAX_WALL_SPEED,
        checks_per_action=max(task.checks_per_action, checks),  # T has so many more steps
        stream=replace(task.stream, has_disc=False),
        control=DirectFrequencies(frequencies=row),
        # from rest it is swept back until it swims
        safe_area=replace(task.safe_area, far_bl=6.0),
        reads_flow_class=False,
    )
    dt = free.interval_T  # sum and change are per decision
    controller = PID(
        frequency=FREQUENCY, gain=3.0, integral_gain=0.15 * dt, damping=4.0 / dt, max_sum=20.0 / dt
    )
    return Trial(
        name="free-stream",
        arm="free stream",
        task=prolong(free, min(periods, MAX_PERIODS)),
        make_policy=lambda: make_gait_policy(controller, free),
        identity=f"PID {vars(controller)}",
    )


def hold_in_free_stream(
    task: KarmanGait,
    *,
    episodes: int,
    periods: float,
    folder: Path,
    flows: Flows,
    progress: Callback = SILENT,
) -> dict[str, Any]:
    """Return the results of free streams: ``flows``, ``work`` as it adds up, and their scales.

    ``flows`` has, per stream, the number of ``episodes``, of those ``held`` to the end, and of the
    latter what ``summarise`` returns, NaN if there is none.
    """
    trial = make_free_trial(task, periods=periods)
    interval_T, rows, work = trial.task.interval_T, [], []
    where: Any = {"folder": folder, "flows": flows, "progress": progress}
    for flow in run_trial(trial, episodes=episodes, **where):
        held = pick(flow, flow.lengths_T >= trial.task.time_limit * interval_T - 1e-6)
        counts = {"episodes": len(flow.flow), "held": len(held.flow)}
        rows.append(counts | summarise(held, interval_T=interval_T))
        work.append(trace_work(held, interval_T=interval_T))
    scales = trial.task.scales
    return {"steps_per_T": scales.period, "mach": scales.mach, "flows": rows, "work": work}


def summarise(held: Histories, *, interval_T: float) -> dict[str, float]:
    """Return work per T, beats per T and drift (L / T) in the second half."""
    num_intervals = held.frequency.shape[1]
    half = num_intervals // 2
    time_T = interval_T * (num_intervals - half)
    row: dict[str, float] = {}
    for name, series in zip(BALANCE, list_works(held), strict=True):
        per_T = (series[:, -1] - series[:, half]) / time_T
        row |= {name: float(per_T.mean()), f"{name}_error": half_width(per_T.tolist())}
    row["frequency"] = float(held.frequency[:, half:].mean())
    row["drift"] = float((held.place[:, -1, 0] - held.place[:, half, 0]).mean()) / time_T
    return row
