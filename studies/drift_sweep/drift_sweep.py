"""Measure the drift of a fish at each tail-beat frequency: ``python -m experiments.drift_sweep``.

In every flow fish beat at one frequency each, from several positions and phases of the wake, with
steering. Their drift per T says which frequencies a row of gears needs: at the lowest the fish must
be swept back, at the highest it must swim up. Writes a table (CSV), settings (JSON) and a figure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import torch
from scipy import stats

from experiments.figures.style import COLOURS
from experiments.gait import trials
from experiments.gait.figures import flow_panels
from experiments.pages import write_csv
from experiments.program import TaskSettings, program
from fishrl.bounds import bounded
from fishrl.envs import KarmanGait
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.stations import SafeArea
from fishrl.training.description import make
from fishrl.training.evaluation import fixed_starts
from fishrl.training.progress import Progress
from fishrl.training.run_folder import write_json

#: Distances behind the disc, body lengths, within which drift counts: near it a fish is sucked in
#: by the recirculation, far from it the wake carries less.
BANDS = ((0.8, 1.4), (1.4, 2.0), (2.0, 2.6), (2.6, 3.5))


@dataclass(frozen=True, kw_only=True)
class DriftSettings(TaskSettings):
    """Settings of a drift sweep.

    Args:
        frequencies: tail-beat frequencies to measure at, beats per T.
        starts: episodes per flow and frequency.
        periods: duration of an episode in T.
        folder: folder for table, settings and figure.
    """

    frequencies: tuple[float, ...] = bounded((0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.2, 2.6), least=0)
    starts: int = bounded(6, least=1)
    periods: int = bounded(8, least=1)
    folder: str = "runs/drift_sweep"


def tabulate(task: KarmanGait, histories: trials.Histories) -> list[dict[str, float]]:
    """Return drift in L / T and work per T for each flow, frequency and band of distances.

    The first T of each episode is left out, in which the beat begins.
    """
    interval_T, x = task.interval_T, histories.place[..., 0]
    steps, work = (values.diff(dim=1) / interval_T for values in (x, histories.work))
    ends = interval_T * torch.arange(1, x.shape[1])
    counted = (ends > 1.0 + 1e-6) & (ends <= histories.lengths_T[:, None] + 1e-6)  # uncut ones
    middle = 0.5 * (x[:, 1:] + x[:, :-1])
    beats = histories.frequency[:, 0]
    table = []
    for (flow, speed), frequency, (low, high) in product(
        enumerate(task.stream.speeds_bl), beats.unique().tolist(), BANDS
    ):
        mine = (histories.flow == flow) & (beats == frequency)
        counts = (middle >= low) & (middle < high) & mine[:, None] & counted
        drift = steps[counts]
        # one mean per episode: successive decisions of a fish are correlated
        means = [
            fish[is_in].mean() for fish, is_in in zip(steps, counts, strict=True) if is_in.any()
        ]
        table.append(
            {
                "stream_speed_bl": speed,
                "frequency": frequency,
                "from_bl": low,
                "to_bl": high,
                "drift": float(np.mean(means)) if means else math.nan,
                "error": float(stats.sem(means)) if len(means) > 1 else math.nan,
                "work": float(work[counts].mean()),
                "samples": len(drift),
            }
        )
    return table


def draw(
    path: Path, table: list[dict[str, float]], speeds: Sequence[float], shedding: Sequence[float]
) -> None:
    """Draw drift against frequency, one panel per flow, one line per band of distances."""
    with flow_panels(path, speeds, height=3.6, width=3.4 * len(speeds) + 0.6) as grid:
        for axes, speed, shed in zip(grid[0], speeds, shedding, strict=True):
            mine = [row for row in table if row["stream_speed_bl"] == speed and row["samples"] >= 3]
            for colour, (low, high) in zip(COLOURS, BANDS, strict=False):
                rows = [row for row in mine if row["from_bl"] == low]
                axes.errorbar(
                    *([row[name] for row in rows] for name in ("frequency", "drift", "error")),
                    color=colour, marker="o", markersize=3.5, capsize=2, linewidth=1.4,
                    label=f"nose {low:g}–{high:g} L behind the disc",
                )  # fmt: skip
            axes.axhline(0.0, color="#555555", linewidth=0.8)
            axes.axvline(shed, color="#999999", linewidth=0.8, linestyle=":")
            axes.set_xlabel("tail beats per T")
        grid[0, 0].set_ylabel("drift  [L/T]   (up: swept downstream)")
        figure, (handles, labels) = grid[0, 0].figure, grid[0, -1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(BANDS), fontsize=8)
        figure.suptitle("dotted: shedding frequency; bars: standard error", fontsize=9)


@program(DriftSettings, groups={"task": "karman_gait", "preset": "gait_small"})
def main(settings: DriftSettings) -> None:
    """Sweep, write, draw."""
    task, frequencies = make(settings.task, kind=KarmanGait), tuple(settings.frequencies)
    trials.check_one_disc(task)
    flows = len(task.stream.speeds_bl)
    task = replace(
        task,
        start_flows=tuple(range(flows)),
        time_limit=round(settings.periods / task.interval_T),
        control=DirectFrequencies(frequencies=frequencies),
        start_x_bl=(1.2, 2.6),
        start_y_bl=trials.START_Y_BL,
        safe_area=SafeArea(near_bl=0.4, far_bl=4.5),
    )
    index = torch.arange(len(frequencies)).repeat_interleave(settings.starts).repeat(flows)
    starts = fixed_starts(task, len(index), seed=0)
    starts["flow_index"] = torch.arange(flows).repeat_interleave(len(index) // flows)
    trial = trials.Trial(
        name="drift",
        arm="drift",
        task=task,
        make_policy=lambda: lambda state: state.set("action", index),
        identity="",
    )
    folder = Path(settings.folder)
    folder.mkdir(parents=True, exist_ok=True)
    with Progress() as progress:
        histories = trials.record(trial, starts, progress=progress)
    table, shedding = tabulate(task, histories), trials.list_shedding(task)
    speeds, scales = task.stream.speeds_bl, task.scales
    numbers = ([float(f"{v:.4g}") for v in row.values()] for row in table)
    write_csv(folder / "drift.csv", list(table[0]), numbers)
    facts = {
        **{name: getattr(scales, name) for name in ("body_length", "reynolds", "tau", "mach")},
        "steps_per_T": scales.period,
        "stream_speeds_bl": list(speeds),
        "shedding_frequencies_per_T": shedding,
        "steering": repr(task.steering),
        "episodes": len(histories.flow),
        "diverged": int(histories.diverged.sum()),
    }
    write_json(folder / "drift.json", facts)
    draw(folder / "drift.png", table, speeds, shedding)
    print(f"written to {folder}: drift.csv, drift.json, drift.png")


if __name__ == "__main__":
    main()
